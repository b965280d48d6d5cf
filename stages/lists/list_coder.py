"""Points in the order of a list: their places, and x, y, z on the lattice of their sensor, on rays, or by their bits.

Stream: length of the places (uint32), the places as gaps, form, left, up and per (uint8, uint16, uint16, uint32), the points.
Forms: points off every lattice, along guessed rays (:mod:`~salpcc.stages.lists.rays.ray_coder`); on the lattice of the sensor model
(:mod:`~salpcc.stages.lists.aimed.aimed_points`), but for a motion by time (:mod:`~salpcc.stages.lists.aimed.moved_points`), or among the points of the static
layer (:mod:`~salpcc.stages.lists.aimed.aimed_layers`), with which their places are told, too; and, where their message tells lasers and times, on rays that
turn steadily (:mod:`~salpcc.stages.lists.timed.timed_points`); on whole angles (:mod:`~salpcc.stages.lists.angled.angled_points`). :mod:`~salpcc.stages.lists.list_plan` chooses.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from salpcc.stages.entropy.buffer import room_for, run_encoder
from salpcc.stages.entropy.integers import decode_column, encode_column
from salpcc.stages.lattice.aim import Placed
from salpcc.stages.lattice.sensor_model import SensorModel
from salpcc.stages.lattice.timed_motion import TimedMotion
from salpcc.stages.lists.aimed.aimed_layers import OWN, Among
from salpcc.stages.lists.aimed.aimed_points import (
    Motion,
    count_off,
    number_of,
    read_body,
    share_on_lattice,
    write_body,
)
from salpcc.stages.lists.aimed.aimed_stream import Aimed, Way
from salpcc.stages.lists.aimed.moved_points import body_of, read_moved
from salpcc.stages.lists.angled.angled_points import count_off_angles, read_angled
from salpcc.stages.lists.learned.learned_lists import LearnedLists
from salpcc.stages.lists.rays.list_layout import find_layout
from salpcc.stages.lists.rays.ray_coder import F32, Layout
from salpcc.stages.lists.rays.ray_forms import ALONG, BITS, GRID, HALVES
from salpcc.stages.lists.rays.ray_stream import read_points, write_points
from salpcc.stages.lists.timed.fit_turning import Fitted
from salpcc.stages.lists.timed.timed_points import Known, ray_number_of, read_timed
from salpcc.stages.lists.timeline import Timeline

Told = Timeline | Placed | None
# The forms after those of rays.
AIMED, TIMED, MOVED, AMONG, PLACED, TIMED_AMONG, ANGLED = 3, 5, 6, 7, 8, 9, 10
_HEAD = struct.Struct("<IBHHI")
_UNITS = (1000, 100, 10000, 1)  # grid lines in a metre
_ON_GRID = 0.9  # of the points
FEWEST = 500  # points that lanes which are told are worth it for
_HOPELESS = 8  # bytes a point
NO_DOUBT = 0.98  # of the returns on the lattice; with fewer, rays are tried, too


def ray_step(max_error: float) -> float:
    """Edge of cubes whose centres are within ``max_error`` metres; 0 where it is exact.

    10 micrometres are set aside for the rounding of the centre to float32.
    """
    return max(2.0 * (max_error - 1e-5) / 1.7320508075688772, 0.0) if max_error > 0 else 0.0


def form_of(points: F32, max_error: float) -> tuple[int, int, float]:
    """Form, grid lines in a metre, and step that points ``(S, 3)`` are coded with."""
    step = ray_step(max_error)
    if step > 0.0:
        return ALONG, 1, step
    some = points[:: len(points) // 16000 + 1]  # zeros are of any form
    returns = some[np.isfinite(some).all(axis=1) & some.any(axis=1)]
    sample = returns[:: len(returns) // 4000 + 1].astype(np.float64)
    for per in _UNITS:
        same = (np.rint(sample * per) / per).astype(np.float32) == sample
        if len(sample) and same.all(axis=1).mean() > _ON_GRID:
            return GRID, per, 0.0
    halves = sample.astype(np.float32).view(np.int32) & 0x1FFF == 0
    return (HALVES if len(sample) and halves.all(axis=1).mean() > _ON_GRID else BITS), 1, 0.0


@dataclass(frozen=True, eq=False)
class Plan:
    """How points ``(S, 3)``, snapped if need be, are coded: on rays, ``chosen`` on the lattice of the sensor, or ``coded`` already: form, body, and the lasers and times that they tell, if they do.

    With ``among`` the points that are chosen are those of the whole list.
    """

    points: F32
    max_error: float
    layout: Layout
    form: int
    per: int
    step: float
    sensor: SensorModel | None = None
    chosen: tuple[Way, Aimed] | None = None
    lanes: NDArray[np.uint8] | None = None
    coded: tuple[int, bytes, Timeline | None] | None = None
    turning: Fitted | None = None  # of form TIMED
    moved_by: TimedMotion | None = None  # of form MOVED
    among: Among | None = None

    @property
    def told(self) -> Told:
        """What a reader knows of the points' lasers and times, or of their places on the lattice."""
        if self.coded is not None:
            return self.coded[2]
        if self.chosen is None or self.among is not None:
            return None
        way, aimed = self.chosen
        return aimed.placed if way.exact and way.motion is None else None

    @cached_property
    def on_rays(self) -> tuple[int, bytes]:
        """Form and body of the points on rays."""
        points, form, per, step, layout = self.points, self.form, self.per, self.step, self.layout
        body = run_encoder(
            lambda out: write_points(points, layout, form, per, step, out, self.lanes), 4 * len(points)
        )
        if form == ALONG and len(body) > _HOPELESS * len(points):  # points that were moved by another layout
            form = BITS
            body = run_encoder(lambda out: write_points(points, layout, BITS, per, 0.0, out), 4 * len(points))
        return form, body

    def take_more_than(self, n_bytes: int) -> bool:
        """Whether exact points on rays take more bytes."""
        out = room_for(4 * len(self.points) + 4096, n_bytes)
        written = write_points(self.points, self.layout, self.form, self.per, self.step, out, self.lanes)
        return not 0 <= written <= n_bytes

    @property
    def share(self) -> float:
        """Of the returns, those on the lattice of the sensor."""
        return 0.0 if self.chosen is None else share_on_lattice(self.chosen[1].kinds)


def along_rays(
    points: F32,
    max_error: float,
    settled: bool = True,
    lanes: NDArray[np.uint8] | None = None,
    like: Layout | None = None,
) -> Plan:
    """Plan for points ``(S, 3)`` on rays guessed from how their list repeats; the rest as for :func:`~.list_plan.plan`."""
    points = np.ascontiguousarray(points)
    lanes = lanes if len(points) >= FEWEST else None
    form, per, step = form_of(points, max_error)
    layout = find_layout(points, form, per, step, 0.0 if settled else max_error, lanes, like)
    return Plan(points, max_error, layout, form, per, step, lanes=lanes)


def off_the_lattice(max_error: float) -> Callable[[F32], bytes]:
    """Return what encodes points ``(S, 3)`` off the lattice of their sensor."""
    return lambda off: encode_list(np.arange(len(off)), along_rays(off, max_error))


def own_line(line: Timeline, own: NDArray[np.bool_]) -> Timeline:
    """Return what is known of the points of a layer; where they were in the list before, its fields do not know."""
    return Timeline(line.laser[own], line.time[own], line.groups)


def encode_list(places: NDArray[np.int64], found: Plan) -> bytes:
    """Encode places ``(S,)`` and points."""
    if len(places) == 0:
        return b""
    gaps = np.diff(places, prepend=-1) - 1
    first = encode_column(gaps)
    if found.coded is not None:
        return _HEAD.pack(len(first), found.coded[0], *found.layout, found.per) + first + found.coded[1]
    if found.chosen is None or found.sensor is None:
        return _on_rays(found, first)
    way = found.chosen[0]
    body = write_body(found.chosen, found.points, found.sensor, off_the_lattice(found.max_error), found.among)
    own = found.points if found.among is None else found.points[found.among.role == OWN]
    if body is None:
        return _on_rays(along_rays(own, found.max_error, lanes=found.lanes), first)
    head = _HEAD.pack(len(first), AIMED, *way.layout, found.per) + first
    if found.among is not None:  # places come with the points
        head = _HEAD.pack(0, PLACED if found.among.width else AMONG, *way.layout, found.per)
    coded = head + body
    if found.share >= NO_DOUBT or found.form == ALONG:
        return coded
    return min(coded, _on_rays(along_rays(own, found.max_error, lanes=found.lanes), first), key=len)


def _on_rays(found: Plan, first: bytes) -> bytes:
    form, body = found.on_rays
    return _HEAD.pack(len(first), form, *found.layout, found.per) + first + body


def decode_list(
    n: int,
    max_error: float,
    data: NDArray[np.uint8],
    sensor: SensorModel | None = None,
    motion: Motion = None,
    lists: LearnedLists | None = None,
    among: Among | None = None,
) -> tuple[NDArray[np.int64], F32, Told, bool]:
    """Inverse of :func:`encode_list`: places, points, :attr:`Plan.told`, and whether the data made sense.

    Sensor, motion and ``among`` are as for :func:`plan`; ``lists``: what was learned of those before.
    """
    nothing = np.zeros(n, np.int64), np.zeros((n, 3), np.float32), None, n == 0
    if n == 0 or len(data) < _HEAD.size:
        return nothing
    first, form, left, up, per = _HEAD.unpack(data[: _HEAD.size].tobytes())
    begin = _HEAD.size + first
    step = ray_step(max_error)
    row = _FORMS.get(form)
    known = form <= BITS or form == HALVES
    if row is not None:
        known = (sensor is not None or not row.of_sensor) and (step == 0.0 or not row.exact)
    if begin > len(data) or not known or per == 0 or (form == ALONG and step == 0.0):
        return nothing
    body = np.ascontiguousarray(data[begin:])
    told = np.ascontiguousarray(data[_HEAD.size : begin])
    given = _Given(n, (left, up), per, max_error, body, sensor, motion, lists, among, told)
    found = row.read(given) if row else _Read(*read_points(n, (left, up), form, per, step, body))
    if found.places is not None:
        return found.places, found.points, found.told, found.sound
    places, sound = given.places()
    return places, found.points, found.told, sound and found.sound


class _Given(NamedTuple):
    """What a reader of points is given: how many, layout and units of corrections, their bytes, what :func:`decode_list` was given, and the bytes of their places."""

    n: int
    layout: Layout
    per: int
    max_error: float
    data: NDArray[np.uint8]
    sensor: SensorModel | None
    motion: Motion
    lists: LearnedLists | None
    among: Among | None
    told: NDArray[np.uint8]

    def places(self) -> tuple[NDArray[np.int64], bool]:
        """Read the places ``(n,)`` of points that are told apart from them, and whether the data made sense."""
        gaps, sound = decode_column(self.n, self.told)
        return np.cumsum(gaps + 1) - 1, sound

    def rest(self, n: int, data: NDArray[np.uint8]) -> tuple[F32, bool]:
        """Read the ``n`` points off the lattice, which are on rays: nothing is off twice."""
        if len(data) >= _HEAD.size and _HEAD.unpack(data[: _HEAD.size].tobytes())[1] in _FORMS:
            return np.zeros((n, 3), np.float32), False
        return decode_list(n, self.max_error, data)[1::2]


class _Read(NamedTuple):
    """What a reader returns: points, whether the data made sense, :attr:`Plan.told`, and their places in the list where these come with them."""

    points: F32
    sound: bool
    told: Told = None
    places: NDArray[np.int64] | None = None


def _read_aimed(given: _Given) -> _Read:
    n, layout, per, max_error, data, sensor, motion, lists, _, _ = given
    assert sensor is not None
    exact = ray_step(max_error) == 0.0
    points, aimed, sound = read_body(n, layout, per, exact, data, sensor, motion, given.rest, lists=lists)
    return _Read(points, sound, aimed.placed if exact and motion is None else None)


def _read_among(given: _Given, placed: bool = False) -> _Read:
    n, layout, per, max_error, data, sensor, _, lists, among, _ = given
    assert sensor is not None
    if among is None or (among.width > 0) != placed:
        return _Read(np.zeros((n, 3), np.float32), False)
    exact = ray_step(max_error) == 0.0
    points, _, sound = read_body(
        len(among.role), layout, per, exact, data, sensor, None, given.rest, lists=lists, among=among
    )
    places = np.flatnonzero(among.role == OWN)
    if len(places) != n:
        return _Read(np.zeros((n, 3), np.float32), False)
    return _Read(np.ascontiguousarray(points[places]), sound, places=places)


def _read_moved(given: _Given) -> _Read:
    n, layout, per, _, data, sensor, _, lists, _, _ = given
    assert sensor is not None
    points, told, sound = read_moved(n, layout, per, data, sensor, given.rest, lists)
    return _Read(points, sound, told)


def _read_timed(given: _Given) -> _Read:
    points, told, sound = read_timed(given.n, given.per, given.data, given.lists)
    return _Read(points, sound, told)


def _read_timed_among(given: _Given) -> _Read:
    among = given.among
    told = among.timed() if among is not None and among.timed is not None and among.width == 0 else None
    if among is None or told is None:
        return _Read(np.zeros((given.n, 3), np.float32), False)
    places, placed = given.places()
    own = np.zeros(len(among.role), np.bool_)
    own[places[(places >= 0) & (places < len(own))]] = True
    if np.count_nonzero(own) != given.n:
        return _Read(np.zeros((given.n, 3), np.float32), False)
    known = Known(~own, among.given, *told[:2])
    points, line, sound = read_timed(len(own), given.per, given.data, given.lists, known)
    return _Read(np.ascontiguousarray(points[own]), placed and sound, own_line(line, own), places)


def _read_angled(given: _Given) -> _Read:
    return _Read(*read_angled(given.n, given.data, given.rest))


class _Form(NamedTuple):
    """A form of points on a lattice, or on rays of known lasers.

    Attributes:
        read: its reader.
        number: of a body, what it goes on from (:mod:`~salpcc.stages.lists.learned.learned_lists`); 0: from nothing.
        off: of a body of n points, those off the lattice of their sensor.
        of_sensor, exact: whether it takes a model of the sensor, and exact points.
    """

    read: Callable[[_Given], _Read]
    number: Callable[[bytes], int]
    off: Callable[[int, bytes], int]
    of_sensor: bool
    exact: bool


_FORMS = {
    AIMED: _Form(_read_aimed, number_of, lambda _, body: count_off(body), True, False),
    AMONG: _Form(_read_among, number_of, lambda _, body: count_off(body), True, False),
    PLACED: _Form(partial(_read_among, placed=True), number_of, lambda _, body: count_off(body), True, False),
    TIMED: _Form(_read_timed, ray_number_of, lambda n, _: n, False, True),
    TIMED_AMONG: _Form(_read_timed_among, ray_number_of, lambda n, _: n, False, True),
    ANGLED: _Form(_read_angled, lambda _: 0, lambda _, body: count_off_angles(body), False, True),
    MOVED: _Form(
        _read_moved,
        lambda body: number_of(body_of(body)),
        lambda _, body: count_off(body_of(body)),
        True,
        True,
    ),
}


def learned_number(data: bytes) -> int:
    """The number of what a stream of strays goes on from (:mod:`~salpcc.stages.lists.learned.learned_lists`); 0: of nothing."""
    row, body = _form_of(data)
    return 0 if row is None else row.number(body)


def off_lattice(n: int, data: bytes) -> int:
    """Of the ``n`` strays of a stream that was checked, those that are not on the lattice of their sensor."""
    row, body = _form_of(data)
    return n if row is None else row.off(n, body)


def are_moved(data: bytes) -> bool:
    """Whether the points of a stream lie on the lattice of their sensor but for a motion by time."""
    return _form_of(data)[0] is _FORMS[MOVED]


def _form_of(data: bytes) -> tuple[_Form | None, bytes]:
    """The form of a stream, None of one of rays, and its body."""
    if len(data) == 0:
        return None, b""
    first, form = _HEAD.unpack_from(data)[:2]
    return _FORMS.get(form), data[_HEAD.size + first :]
