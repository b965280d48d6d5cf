"""Strays on the lattice of the archive's sensor model, and those off it on rays as ever: form AIMED of :mod:`~salpcc.stages.lists.list_coder`.

Body: form of the corrections (ALONG: none), 8 where points of a laser are shuffled, and 16 times the number of what was learned (:mod:`~salpcc.stages.lists.learned.learned_lists`; 0: nothing) in a uint8, counts per level, points off the lattice, bytes of the walk (uint32 each); the walk
of :mod:`.aimed_coder`; the stream of :mod:`~salpcc.stages.lists.list_coder` of the points off the lattice, if there are any.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from salpcc.stages.lattice.find_lasers import find_firing
from salpcc.stages.lattice.sensor_model import SensorModel
from salpcc.stages.lists.aimed.aimed_layers import OWN, Among
from salpcc.stages.lists.aimed.aimed_stream import (
    EXACT_REACH,
    Aimed,
    Way,
    is_shuffled,
    no_points,
    put,
    read_aimed,
    settle,
    step_of,
    write_aimed,
)
from salpcc.stages.lists.aimed.aimed_symbols import AIMED, OFF
from salpcc.stages.lists.learned.learned_lists import Learned, LearnedLists
from salpcc.stages.lists.learned.moved_sweep import Clock
from salpcc.stages.lists.rays.list_layout import likely_layouts
from salpcc.stages.lists.rays.ray_coder import F32, Layout
from salpcc.stages.lists.rays.ray_forms import ALONG, BITS
from salpcc.stages.lists.timeline import Passed

MOST_POINTS = 1 << 22
OFF_LASER = 255
_BODY = struct.Struct("<BIII")
_FEWEST = 500
_LEAST_SHARE = 0.5  # of the returns that must lie on the lattice
_TRIED = 1 << 13  # points
_LARGEST_STEP = 1 << 16
_SHUFFLED = 8  # of the form

Motion = NDArray[np.float64] | None
Array = NDArray[np.uint8]


def choose(
    points: F32,
    form: int,
    per: int,
    max_error: float,
    sensor: SensorModel,
    motion: Motion,
    settled: bool,
    s: NDArray[np.float64] | None = None,
    clock: Clock | None = None,
    like: Layout | None = None,
    learned: Learned | None = None,
    among: Among | None = None,
) -> tuple[Way, Aimed] | None:
    """Return how points ``(S, 3)`` are best put on the lattice, and there; None where too few of them lie on it.

    Args:
        form, per: of corrections; ALONG where an error is allowed.
        settled: the points were put there before, and no bit may change.
        s, clock: of each point ``(S,)``, and of the cloud, where the motion is by time.
        like: the layout that is taken without a trial.
        learned: of such points before, for efforts above ``fast``.
        among: which of the points are to be coded, where it is not all of them.
    """
    if not _FEWEST <= len(points) <= MOST_POINTS:
        return None
    exact = form != ALONG
    moved = None if motion is None else tuple(motion.tolist())
    layouts: list[Layout] = [(1, 0)]
    if moved is not None and s is None:
        layouts = [(find_firing(points.astype(np.float64)), 1)]
        if layouts[0][0] < 2:
            return None
    way = Way(layouts[0], form, per, exact, step_of(0.0 if exact else max_error, sensor), moved, s, clock)
    reach = EXACT_REACH if exact else (0.0 if settled else max_error)
    aimed = put(points, sensor, way, reach)
    if share_on_lattice(aimed.kinds) < _LEAST_SHARE:
        return None
    if like is not None and (moved is None or s is not None):
        layouts = [like]
    elif moved is None or s is not None:
        layouts = likely_layouts(points, lanes=among is None or among.width == 0)
        if among is not None and among.width and (1, among.width) not in layouts:
            layouts.append((1, among.width))
    ways = [replace(way, layout=layout) for layout in layouts]
    way = ways[0]
    if len(ways) > 1:
        tried = among if among is not None and len(among.given) == 0 else None  # few points tell little
        way = min(ways, key=lambda w: _tried(aimed, points, sensor, w, tried))
    if not exact and not settled:
        aimed = settle(aimed, points, sensor, way, max_error, among)
        if share_on_lattice(aimed.kinds) < _LEAST_SHARE:  # they would not be found there again
            return None
    return replace(way, learned=learned, shuffled=learned is not None and is_shuffled(aimed, sensor)), aimed


def share_on_lattice(kinds: Array) -> float:
    """Share of the returns among points of these kinds ``(S,)`` that lie on the lattice; 1 without a return."""
    off, on = int((kinds == OFF).sum()), int((kinds == AIMED).sum())
    return 1.0 - off / max(off + on, 1)


def _tried(aimed: Aimed, points: F32, sensor: SensorModel, way: Way, among: Among | None) -> int:
    """Bytes that the beginning takes."""
    part = slice(0, _TRIED)
    first = aimed.some(part)
    out = np.empty(32 * len(first.points) + 4096, np.uint8)
    way = way if way.s is None else replace(way, s=way.s[part])
    some = None if among is None else among.first(_TRIED)
    written = write_aimed(first, np.ascontiguousarray(points[part]), sensor, way, out, some)
    return written if written >= 0 else len(out)


def write_body(
    chosen: tuple[Way, Aimed],
    points: F32,
    sensor: SensorModel,
    write_rest: Callable[[F32], bytes],
    among: Among | None = None,
) -> bytes | None:
    """Encode points ``(S, 3)``; ``write_rest`` encodes those off the lattice. None where a reader would have other points.

    Args:
        among: which of the points are encoded, where a reader has others, or none.
    """
    way, aimed = chosen
    out = np.empty(32 * len(points) + 4096, np.uint8)
    written = write_aimed(aimed, points, sensor, way, out, among)
    if written < 0:
        return None
    off = aimed.kinds == OFF
    if among is not None:
        off &= among.role == OWN
    number = 0 if way.learned is None else way.learned.number
    head = _BODY.pack(way.form + _SHUFFLED * way.shuffled + (number << 4), way.step, int(off.sum()), written)
    return (
        head + out[:written].tobytes() + (write_rest(np.ascontiguousarray(points[off])) if off.any() else b"")
    )


def read_body(
    n: int,
    layout: Layout,
    per: int,
    exact: bool,
    data: Array,
    sensor: SensorModel,
    motion: Motion,
    read_rest: Callable[[int, Array], tuple[F32, bool]],
    s: NDArray[np.float64] | None = None,
    clock: Clock | None = None,
    lists: LearnedLists | None = None,
    among: Among | None = None,
) -> tuple[F32, Aimed, bool]:
    """Inverse of :func:`write_body`: points ``(n, 3)``, where they are on the lattice, and whether the data made sense.

    Args:
        among: in which points that are not GIVEN get their roles.
    """
    nothing = np.zeros((n, 3), np.float32), no_points(n), False
    if n > MOST_POINTS or len(data) < _BODY.size:
        return nothing
    form, step, off, length = _BODY.unpack(data[: _BODY.size].tobytes())
    end = _BODY.size + length
    shuffled, form, number = bool(form & _SHUFFLED), form & 7, form >> 4
    if form > BITS or not 1 <= step <= _LARGEST_STEP or off > n or end > len(data):
        return nothing
    if (
        (form != ALONG) != exact
        or (exact and step != 1)
        or (motion is not None and s is None and layout[0] < 2)
    ):
        return nothing
    if (number and lists is None) or (shuffled and not number):
        return nothing
    moved = None if motion is None else tuple(motion.tolist())
    learned = lists.of_number(number) if lists is not None and number else None
    way = Way(layout, form, per, form != ALONG, step, moved, s, clock, learned, shuffled)
    aimed, sound = read_aimed(n, sensor, way, np.ascontiguousarray(data[_BODY.size : end]), among)
    if learned is not None:
        learned.settle()
    points = aimed.points
    are_off = aimed.kinds == OFF
    if among is not None:
        are_off &= among.role == OWN
    if not sound or int(are_off.sum()) != off:
        return nothing
    if off:
        points[are_off], sound = read_rest(off, np.ascontiguousarray(data[end:]))
    return points, aimed, bool(sound and (off > 0 or end == len(data)))


def lasers_of(aimed: Aimed) -> Array:
    """The lasers ``(S,)`` that are known; OFF_LASER of points that are of none."""
    return np.where(aimed.kinds == AIMED, aimed.laser, OFF_LASER).astype(np.uint8)


def number_of(body: bytes | Array) -> int:
    """The number of what a body that :func:`write_body` wrote goes on from; 0: of nothing."""
    return int(body[0]) >> 4


def passed_of(body: Array, lists: LearnedLists | None) -> Passed | None:
    """Where the points of a body that :func:`read_body` has read were in the list before, if that is known."""
    number = number_of(body) if len(body) else 0
    return None if lists is None or not number else lists.of_number(number).passed


def count_off(body: bytes) -> int:
    """Points off the lattice, of a body that :func:`write_body` wrote."""
    return int(_BODY.unpack_from(body)[2])
