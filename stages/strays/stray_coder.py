"""Strays, the points without a lattice: their places, and x, y, z as :mod:`~salpcc.stages.strays.rays.ray_coder` has them.

Stream: length of the places (uint32), the places as gaps, form, left, up and per (uint8, uint16, uint16, uint32), the points.
Many strays that lie on the lattice of the sensor model after all, as of a sensor whose files no other coder knows, are coded by it
(:mod:`~salpcc.stages.strays.aimed.aimed_strays`). Strays whose lasers and times their message tells may lie on rays that turn steadily (:mod:`~salpcc.stages.strays.timed.timed_strays`), or on the lattice but for a
motion by time (:mod:`~salpcc.stages.strays.aimed.moved_strays`); then these two are told with them, and need not be told again.
Those of a movable layer are told among those of the static one (:mod:`~salpcc.stages.strays.aimed.aimed_layers`), and with them their places.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from salpcc.stages.entropy.buffer import room_for, run_encoder
from salpcc.stages.entropy.integers import decode_integers, encode_integers, integer_model
from salpcc.stages.lattice.aim import Placed
from salpcc.stages.lattice.publish import from_ordered_bits, ordered_bits
from salpcc.stages.lattice.sensor_model import SensorModel
from salpcc.stages.lattice.timed_motion import TimedMotion, find_timed_motion, timed_places
from salpcc.stages.strays.aimed.aimed_layers import GIVEN, OWN, Among
from salpcc.stages.strays.aimed.aimed_strays import (
    Motion,
    choose,
    count_off,
    number_of,
    read_body,
    share_on_lattice,
    write_body,
)
from salpcc.stages.strays.aimed.aimed_stream import Aimed, Way
from salpcc.stages.strays.aimed.aimed_symbols import OFF
from salpcc.stages.strays.aimed.moved_strays import body_of, read_moved, write_moved
from salpcc.stages.strays.learned.learned_lists import Learned, LearnedLists
from salpcc.stages.strays.learned.moved_sweep import Clock
from salpcc.stages.strays.rays.list_layout import find_layout
from salpcc.stages.strays.rays.ray_coder import F32, Layout
from salpcc.stages.strays.rays.ray_forms import ALONG, BITS, GRID, HALVES
from salpcc.stages.strays.rays.ray_stream import move_points, read_points, write_points
from salpcc.stages.strays.timed.fit_turning import Fitted
from salpcc.stages.strays.timed.timed_strays import Known, ray_number_of, read_timed, write_timed
from salpcc.stages.strays.timeline import Timeline

Told = Timeline | Placed | None
AIMED, TIMED, MOVED, AMONG, PLACED, TIMED_AMONG = 3, 5, 6, 7, 8, 9  # the forms after those of rays
_HEAD = struct.Struct("<IBHHI")
_UNITS = (1000, 100, 10000, 1)  # grid lines in a metre
_ON_GRID = 0.9  # of the points
_FEWEST = 500  # points that lanes which are told are worth it for
_HOPELESS = 8  # bytes a point
_NO_DOUBT = 0.98  # of the returns on the lattice; with fewer, rays are tried, too


def ray_step(max_error: float) -> float:
    """Edge of cubes whose centres are within ``max_error`` metres; 0 where it is exact.

    10 micrometres are set aside for the rounding of the centre to float32.
    """
    return max(2.0 * (max_error - 1e-5) / 1.7320508075688772, 0.0) if max_error > 0 else 0.0


def _form(points: F32, max_error: float) -> tuple[int, int, float]:
    """Form, grid lines in a metre, and step that points ``(S, 3)`` are coded with."""
    step = ray_step(max_error)
    if step > 0.0:
        return ALONG, 1, step
    returns = points[np.isfinite(points).all(axis=1) & points.any(axis=1)]  # zeros are of any form
    sample = returns[:: len(returns) // 4000 + 1].astype(np.float64)
    for per in _UNITS:
        same = (np.rint(sample * per) / per).astype(np.float32) == sample
        if len(sample) and same.all(axis=1).mean() > _ON_GRID:
            return GRID, per, 0.0
    halves = sample.astype(np.float32).view(np.int32) & 0x1FFF == 0
    return (HALVES if len(sample) and halves.all(axis=1).mean() > _ON_GRID else BITS), 1, 0.0


@dataclass(frozen=True, eq=False)
class Plan:
    """How points ``(S, 3)``, snapped if need be, are coded: on rays, ``chosen`` on the lattice of the sensor, or ``coded`` already: form, body, and the lasers and times that they tell.

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
    coded: tuple[int, bytes, Timeline] | None = None
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


def plan(
    points: F32,
    max_error: float,
    sensor: SensorModel | None = None,
    motion: Motion = None,
    settled: bool = True,
    lanes: NDArray[np.uint8] | None = None,
    times: NDArray[np.int64] | None = None,
    like: Layout | None = None,
    turning: Fitted | None = None,
    moved_by: TimedMotion | None = None,
    learned: Learned | None = None,
    among: Among | None = None,
) -> Plan:
    """Plan how to encode points ``(S, 3)``.

    Args:
        sensor: whose lattice the points may lie on.
        motion: by place in the list, that moved them off it (:mod:`salpcc.stages.lattice.list_motion`).
        settled: they were snapped, if need be, and no bit may change.
        lanes: the laser of each ``(S,)``, where the sensor tells; a guess will do.
        times: of each ``(S,)``, where they are told.
        like: the layout of the scan before, which exact points are taken to have, too.
        turning: of the scan before; then rays are sought first, and from these.
        moved_by: what moved the scan before, which a search for a motion by time begins with.
        learned: of such points before, for efforts above ``fast``.
        among: where they stand in a list of two layers.
    """
    all_lanes, lanes = lanes, lanes if len(points) >= _FEWEST else None
    points = np.ascontiguousarray(points)
    form, per, step = _form(points, max_error)
    fix = BITS if form == HALVES else form
    exact = settled and step == 0.0
    like = like if exact else None
    among = among if motion is None else None
    beside = among is not None and len(among.given) > 0  # a static layer, which tells more than times

    def rays() -> Plan:
        layout = find_layout(points, form, per, step, 0.0 if settled else max_error, lanes, like)
        on_rays = Plan(points, max_error, layout, form, per, step, lanes=lanes)
        if exact and all_lanes is not None and among is not None and beside:
            timed = _timed_among(points, all_lanes, among, form, per, turning, learned)
            if timed is not None and on_rays.take_more_than(len(timed[0])):
                return replace(on_rays, coded=(TIMED_AMONG, *timed[:2]), turning=timed[2])
        if exact and lanes is not None and times is not None:
            timed = write_timed(points, lanes, times, form, per, turning, learned)
            if timed is not None and on_rays.take_more_than(len(timed[0])):
                return replace(on_rays, coded=(TIMED, *timed[:2]), turning=timed[2])
        return on_rays

    if turning is not None and (again := rays()).coded is not None:  # as those of the scan before were
        return again
    moved = None
    if sensor is not None and exact and times is not None:
        moved = partial(_moved_in_time, points, form, fix, per, sensor, lanes, times, like, moved_by, learned)
    if moved is not None and not beside and (found := moved()) is not None:
        return found
    aimed = None
    if sensor is not None:
        whole = points if among is None else among.merged(points)
        chosen = choose(
            whole, fix, per, max_error, sensor, motion, settled, like=like, learned=learned, among=among
        )
        if chosen is not None:
            layout = chosen[0].layout
            aimed = Plan(whole, max_error, layout, fix, per, step, sensor, chosen, lanes, among=among)
    if aimed and (settled or aimed.share >= _NO_DOUBT):
        return aimed
    if moved is not None and beside and (found := moved()) is not None:
        return found
    rest = rays()
    return min(aimed, rest, key=_size) if aimed and rest.coded is None else rest


def _timed_among(
    points: F32,
    lanes: NDArray[np.uint8],
    among: Among,
    form: int,
    per: int,
    turning: Fitted | None,
    learned: Learned | None,
) -> tuple[bytes, Timeline, Fitted] | None:
    """Encode points ``(S, 3)`` on the rays of both layers; None where there are none."""
    told = among.timed() if among.timed is not None else None
    if told is None:
        return None
    given = among.role == GIVEN
    laser, time = np.empty(len(given), np.uint8), np.empty(len(given), np.int64)
    laser[given], time[given], time[~given] = told
    laser[~given] = lanes
    found = write_timed(among.merged(points), laser, time, form, per, turning, learned, given)
    return found and (found[0], _own_line(found[1], ~given), found[2])


def _own_line(line: Timeline, own: NDArray[np.bool_]) -> Timeline:
    """Return what is known of the points of a layer; where they were in the list before, its fields do not know."""
    return Timeline(line.laser[own], line.time[own], line.groups)


def _moved_in_time(
    points: F32,
    form: int,
    fix: int,
    per: int,
    sensor: SensorModel,
    lanes: NDArray[np.uint8] | None,
    times: NDArray[np.int64],
    like: Layout | None,
    moved_by: TimedMotion | None,
    learned: Learned | None,
) -> Plan | None:
    """Plan for points ``(S, 3)`` that a motion by time moved off the lattice; None where it is not found."""
    found = find_timed_motion(points, sensor, times, lanes, moved_by) if len(points) >= _FEWEST else None
    if found is None:
        return None
    motion, reference = found
    s = timed_places(times, reference)
    chosen = choose(points, fix, per, 0.0, sensor, motion, True, s, Clock.of(times), like, learned)
    moved = write_moved(chosen, points, sensor, times, reference, _rest(0.0)) if chosen else None
    if chosen is None or moved is None:
        return None
    layout = chosen[0].layout
    return Plan(points, 0.0, layout, form, per, 0.0, sensor, chosen, lanes, (MOVED, *moved), moved_by=found)


def _rest(max_error: float) -> Callable[[F32], bytes]:
    """Return what encodes points ``(S, 3)`` off the lattice."""
    return lambda off: encode_strays(np.arange(len(off)), plan(off, max_error))


def snap(
    points: F32,
    max_error: float,
    sensor: SensorModel | None = None,
    motion: Motion = None,
    among: Among | None = None,
) -> F32:
    """Move points ``(S, 3)`` to where the coder will put them, where that keeps the bound; the rest as for :func:`plan`."""
    if ray_step(max_error) == 0.0 or len(points) == 0:
        return points
    return _moved(plan(points, max_error, sensor, motion, settled=False, among=among))


def _moved(found: Plan) -> F32:
    """Return where the points of a plan that is not settled go."""
    if found.chosen is None:
        return move_points(found.points, found.layout, found.form, found.per, found.step, found.max_error)[0]
    moved = found.chosen[1].points.copy()
    off, own = found.chosen[1].kinds == OFF, slice(None)
    if found.among is not None:
        own = found.among.role == OWN
        off &= own
    moved[off] = snap(found.points[off], found.max_error)
    return moved[own]


def _size(found: Plan) -> int:
    """Bytes that the points of a plan that is not settled take once they are moved."""
    points = moved = _moved(found)
    if found.among is not None:
        points = found.among.merged(moved)
    return len(encode_strays(np.arange(len(moved)), replace(found, points=points)))


def encode_strays(places: NDArray[np.int64], found: Plan) -> bytes:
    """Encode places ``(S,)`` and points."""
    if len(places) == 0:
        return b""
    gaps = np.diff(places, prepend=-1) - 1
    first = run_encoder(lambda out: int(encode_integers(gaps[:, None], integer_model(1), out)), len(places))
    if found.coded is not None:
        return _HEAD.pack(len(first), found.coded[0], *found.layout, found.per) + first + found.coded[1]
    if found.chosen is None or found.sensor is None:
        return _on_rays(found, first)
    way = found.chosen[0]
    body = write_body(found.chosen, found.points, found.sensor, _rest(found.max_error), found.among)
    own = found.points if found.among is None else found.points[found.among.role == OWN]
    if body is None:
        return _on_rays(plan(own, found.max_error, lanes=found.lanes), first)
    head = _HEAD.pack(len(first), AIMED, *way.layout, found.per) + first
    if found.among is not None:  # places come with the points
        head = _HEAD.pack(0, PLACED if found.among.width else AMONG, *way.layout, found.per)
    coded = head + body
    if found.share >= _NO_DOUBT or found.form == ALONG:
        return coded
    return min(coded, _on_rays(plan(own, found.max_error, lanes=found.lanes), first), key=len)


def _on_rays(found: Plan, first: bytes) -> bytes:
    form, body = found.on_rays
    return _HEAD.pack(len(first), form, *found.layout, found.per) + first + body


def decode_strays(
    n: int,
    max_error: float,
    data: NDArray[np.uint8],
    sensor: SensorModel | None = None,
    motion: Motion = None,
    lists: LearnedLists | None = None,
    among: Among | None = None,
) -> tuple[NDArray[np.int64], F32, Told, bool]:
    """Inverse of :func:`encode_strays`: places, points, :attr:`Plan.told`, and whether the data made sense.

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
    """What a reader of points is given: how many, layout and units of corrections, their bytes, what :func:`decode_strays` was given, and the bytes of their places."""

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
        rows, sound = decode_integers(self.n, 1, integer_model(1), self.told)
        return np.cumsum(rows[:, 0] + 1) - 1, bool(sound)

    def rest(self, n: int, data: NDArray[np.uint8]) -> tuple[F32, bool]:
        """Read the ``n`` points off the lattice."""
        return decode_strays(n, self.max_error, data)[1::2]


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
    return _Read(np.ascontiguousarray(points[own]), placed and sound, _own_line(line, own), places)


class _Form(NamedTuple):
    """A form of points on a lattice, or on rays of known lasers.

    Attributes:
        read: its reader.
        number: of a body, what it goes on from (:mod:`~salpcc.stages.strays.learned.learned_lists`); 0: from nothing.
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
    MOVED: _Form(
        _read_moved,
        lambda body: number_of(body_of(body)),
        lambda _, body: count_off(body_of(body)),
        True,
        True,
    ),
}


def learned_number(data: bytes) -> int:
    """The number of what a stream of strays goes on from (:mod:`~salpcc.stages.strays.learned.learned_lists`); 0: of nothing."""
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


def encode_floats(values: NDArray[np.float32], out: NDArray[np.uint8]) -> int:
    """Encode float32 values ``(S,)`` exactly; return the bytes written to ``out``, -1 if full."""
    return int(encode_integers(ordered_bits(np.ascontiguousarray(values))[:, None], integer_model(1), out))


def decode_floats(n: int, data: NDArray[np.uint8]) -> tuple[NDArray[np.float32], bool]:
    """Inverse of :func:`encode_floats`."""
    rows, sound = decode_integers(n, 1, integer_model(1), data)
    return from_ordered_bits(np.clip(rows[:, 0], -(1 << 31), (1 << 31) - 1)), bool(sound)
