"""Points whose lasers and times are told, on the rays of lasers that turn steadily: form TIMED of :mod:`~salpcc.stages.lists.list_coder`.

Body: bytes of the timeline (uint32), the timeline (:mod:`~salpcc.stages.lists.timeline`); form of the coordinates and 16 times the number of what was learned (:mod:`~salpcc.stages.lists.learned.learned_lists`; 0:
nothing), lasers less one, sensors (uint8 each); the float32 numbers of :class:`~.turning_rays.Turning`, array by array, and with a number those of the motion since the scan before (:mod:`~salpcc.stages.lists.learned.between`); the walk of :mod:`.timed_coder`.
"""

from __future__ import annotations

import struct
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from salpcc.stages.entropy.range_coder import finish_encoder, start_decoder, start_encoder
from salpcc.stages.lists.learned.learned_lists import Learned, LearnedLists
from salpcc.stages.lists.learned.seen_rays import Swept, eyes_of
from salpcc.stages.lists.rays.ray_coder import F32
from salpcc.stages.lists.rays.ray_forms import BITS, GRID, HALVES
from salpcc.stages.lists.timed.fit_turning import Fitted, fit_again, fit_turning
from salpcc.stages.lists.timed.timed_coder import code_timed, new_models
from salpcc.stages.lists.timed.timed_layers import heeded_points
from salpcc.stages.lists.timed.turning_rays import Turning
from salpcc.stages.lists.timeline import I64, Given, Lasers, Timeline, decode_timeline, find_timelines

_BODY, _RAYS = struct.Struct("<I"), struct.Struct("<BBB")
_FEWEST, _MOST_POINTS = 2000, 1 << 22
_LARGEST = 1e4  # of any number
_BETWEEN = 6  # numbers of the motion between sweeps
_LOOSE = 3e-3  # radians; lasers that are farther off than that turn in another way
_HOPELESS = 6.0  # bits a point of a timeline

Array = NDArray[np.uint8]


class Known(NamedTuple):
    """What a reader has of a list: which points ``(N,)``, these ``(T, 3)``, their lasers and times ``(T,)``."""

    which: NDArray[np.bool_]
    points: F32
    laser: Lasers
    time: I64


def write_timed(
    points: F32,
    laser: Lasers,
    time: I64,
    form: int,
    per: int,
    like: Fitted | None = None,
    learned: Learned | None = None,
    given: Given = None,
) -> tuple[bytes, Timeline, Fitted] | None:
    """Encode points ``(S, 3)`` of lasers ``(S,)`` at times ``(S,)``; None where they do not go round, or a reader would have others.

    Args:
        like: the rays of the scan before, to begin with.
        learned: of such points before, for efforts above ``fast``.
        given: which points ``(S,)`` a reader has; None: none.
    """
    if not _FEWEST <= len(points) <= _MOST_POINTS:
        return None
    lines = find_timelines(laser, time, given)
    if not lines or 8 * len(lines[0][1]) > _HOPELESS * len(points):
        return None
    wide, lasers, scaled = points.astype(np.float64), laser.astype(np.int64), _scaled(time)
    fits = []
    for line, told in lines if like is not None else []:
        again = fit_again(wide, lasers, line.group, scaled, like)  # type: ignore[arg-type]
        fits += [] if again is None else [(again, line, told)]
    for line, told in lines if not fits else []:
        anew = fit_turning(wide, lasers, line.group, scaled)
        fits += [(anew, line, told)] if anew is not None and anew[1] < _LOOSE else []
    if not fits:
        return None
    between = np.zeros(6, np.float32)
    if learned is not None:
        origin = fits[0][0][0].sensors[:, :3].mean(axis=0).astype(np.float64)
        between = learned.between(wide, lasers, origin)

    def written(fitted: Fitted, line: Timeline, told: bytes) -> tuple[bytes, Timeline] | None:
        return _written(points, line, told, fitted[0], form, per, learned, between, given)

    best = min(fits, key=lambda fit: fit[0][1])
    if learned is not None and len(fits) > 1:  # the nearest may be of too many sensors to learn much
        sizes = [len(one[0]) if one is not None else np.inf for one in (written(*fit) for fit in fits)]
        best = fits[int(np.argmin(sizes))]
    coded = written(*best)
    return coded and (*coded, best[0])


def _written(
    points: F32,
    line: Timeline,
    told: bytes,
    turning: Turning,
    form: int,
    per: int,
    learned: Learned | None,
    between: NDArray[np.float32],
    given: Given,
) -> tuple[bytes, Timeline] | None:
    """Encode points of these lasers, times and rays, and what a reader will know of them; None where it would have others."""
    out = np.empty(48 * len(points) + 4096, np.uint8)
    state, back = start_encoder(), points.copy()
    known = _code(True, back, line, turning, form, per, learned, between, given, state, out)
    written = int(finish_encoder(state, out)) if state[3] == 0 else -1
    if written < 0 or (back.view(np.int32) != points.view(np.int32)).any():
        return None
    number = 0 if learned is None else learned.number
    rays = _RAYS.pack(form + (number << 4), len(turning.lasers) - 1, len(turning.sensors))
    told_of = (turning.lasers, turning.sensors, turning.motion, between[: _BETWEEN * (number > 0)])
    numbers = b"".join(a.astype("<f4").tobytes() for a in told_of)
    return _BODY.pack(len(told)) + told + rays + numbers + out[:written].tobytes(), known


def read_timed(
    n: int, per: int, data: Array, lists: LearnedLists | None = None, given: Known | None = None
) -> tuple[F32, Timeline, bool]:
    """Inverse of :func:`write_timed`: points ``(n, 3)``, their timeline, and whether the data made sense; ``lists``: what was learned before."""
    points, line = np.zeros((n, 3), np.float32), Timeline(np.zeros(n, np.uint8), np.zeros(n, np.int64), 0)
    raw = data.tobytes()
    if not 0 < n <= _MOST_POINTS or len(raw) < _BODY.size:
        return points, line, False
    begin = _BODY.size + _BODY.unpack_from(raw)[0]
    if begin + _RAYS.size > len(raw):
        return points, line, False
    known = None
    if given is not None:
        known = given.which
        points[known] = given.points
    line, sound = decode_timeline(
        n, raw[_BODY.size : begin], given and (given.which, given.laser, given.time)
    )
    form, lasers, sensors = _RAYS.unpack_from(raw, begin)
    form, number = form & 15, form >> 4
    lasers += 1
    sizes = (2 * lasers, 7 * sensors, 6, _BETWEEN if number else 0)
    end = begin + _RAYS.size + 4 * sum(sizes)
    sound = sound and form in (GRID, BITS, HALVES) and end <= len(raw) and int(line.laser.max()) < lasers
    sound = sound and (number == 0 or lists is not None)
    if not sound or int(line.group[line.laser].max()) >= sensors:
        return points, line, False
    numbers = np.frombuffer(raw, "<f4", sum(sizes), begin + _RAYS.size).astype(np.float32)
    if not (np.abs(numbers) < _LARGEST).all():
        return points, line, False
    a, b, c, between = np.split(numbers, np.cumsum(sizes)[:3])
    learned = lists.of_number(number) if lists is not None and number else None
    walk = np.frombuffer(bytearray(raw[end:]), np.uint8)
    state = start_decoder(walk)
    turning = Turning(a.reshape(-1, 2), b.reshape(-1, 7), c)
    line = _code(False, points, line, turning, form, per, learned, between, known, state, walk)
    if learned is not None:
        learned.settle()
    return points, line, bool(state[3] == 0)


def ray_number_of(body: bytes) -> int:
    """The number of what a body that :func:`write_timed` wrote goes on from; 0: of nothing."""
    return body[_BODY.size + _BODY.unpack_from(body)[0]] >> 4


def _code(
    writing: bool,
    points: F32,
    line: Timeline,
    turning: Turning,
    form: int,
    per: int,
    learned: Learned | None,
    between: NDArray[np.float32],
    given: Given,
    state: I64,
    data: Array,
) -> Timeline:
    """Write or read points; return their timeline with all that is known of it then."""
    above, below = _beside(turning, line)
    rays = tuple(np.ascontiguousarray(a) for a in (turning.lasers, turning.sensors, turning.motion))
    known = np.zeros(len(points), np.bool_) if given is None else given
    heeded = slice(None) if given is None else heeded_points(line.laser, given, above, below)
    own = points[heeded]
    walk = None
    if learned is not None:
        walk = learned.turning(Swept(own, between), eyes_of(turning, line.group))
        line = replace(line, passed=learned.passed)
    code_timed(
        writing, own, known[heeded], line.laser[heeded], line.group, _scaled(line.time)[heeded], rays, (above, below), form, float(per),
        new_models(), walk, state, data,
    )  # fmt: skip
    points[heeded] = own
    return line


def _beside(turning: Turning, line: Timeline) -> tuple[I64, I64]:
    """The lasers above and below each, of the same sensor; -1: none."""
    order = np.argsort(-turning.lasers[:, 0].astype(np.float64), kind="stable")
    above, below = np.full(len(order), -1), np.full(len(order), -1)
    for sensor in range(len(turning.sensors)):
        own = order[line.group[order] == sensor]
        above[own[1:]], below[own[:-1]] = own[:-1], own[1:]
    return above, below


def _scaled(time: I64) -> NDArray[np.float64]:
    """Times ``(N,)`` from -1/2, the first, to 1/2, the last."""
    first, last = int(time.min()), int(time.max())
    return np.asarray((time - first) / float(max(last - first, 1)) - 0.5)
