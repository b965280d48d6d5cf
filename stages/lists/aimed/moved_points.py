"""Strays on the lattice of the sensor, but for a motion that follows their times: form MOVED of :mod:`~salpcc.stages.lists.list_coder`.

Body: bytes of the times (uint32); the times, the first (int64) and a column of residuals (:mod:`~salpcc.stages.entropy.columns`); the reference and the
six numbers of the motion (float64, :mod:`~salpcc.stages.lattice.timed_motion`); the body of :mod:`.aimed_points`.
"""

from __future__ import annotations

import struct
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from salpcc.stages.entropy.columns import LEFT, decode_residuals, encode_residuals
from salpcc.stages.lattice.sensor_model import SensorModel
from salpcc.stages.lattice.timed_motion import timed_places
from salpcc.stages.lists.aimed.aimed_points import MOST_POINTS, lasers_of, passed_of, read_body, write_body
from salpcc.stages.lists.aimed.aimed_stream import Aimed, Way
from salpcc.stages.lists.learned.learned_lists import LearnedLists
from salpcc.stages.lists.learned.moved_sweep import Clock
from salpcc.stages.lists.rays.ray_coder import F32, Layout
from salpcc.stages.lists.timeline import I64, Timeline

_LENGTH, _FIRST, _MOTION = struct.Struct("<I"), struct.Struct("<q"), struct.Struct("<7d")
_LARGEST = 1e6
_WIDTH = 64

Array = NDArray[np.uint8]


def write_moved(
    chosen: tuple[Way, Aimed],
    points: F32,
    sensor: SensorModel,
    time: I64,
    reference: float,
    write_rest: Callable[[F32], bytes],
) -> tuple[bytes, Timeline] | None:
    """Encode points ``(S, 3)`` at times ``(S,)``, put on the lattice by the motion of ``chosen``; None where a reader would have others."""
    way, aimed = chosen
    body = write_body(chosen, points, sensor, write_rest)
    if body is None or way.motion is None:
        return None
    first = int(time[0])
    column = encode_residuals(time - first, np.zeros(len(time), np.bool_), 1, LEFT, _WIDTH)
    times = _FIRST.pack(first) + column
    told = Timeline(lasers_of(aimed), time, 0, None if way.learned is None else way.learned.passed)
    return _LENGTH.pack(len(times)) + times + _MOTION.pack(reference, *way.motion) + body, told


def read_moved(
    n: int,
    layout: Layout,
    per: int,
    data: Array,
    sensor: SensorModel,
    read_rest: Callable[[int, Array], tuple[F32, bool]],
    lists: LearnedLists | None = None,
) -> tuple[F32, Timeline, bool]:
    """Inverse of :func:`write_moved`: points ``(n, 3)``, their lasers and times, and whether the data made sense."""
    nothing = np.zeros((n, 3), np.float32), Timeline(np.zeros(n, np.uint8), np.zeros(n, np.int64), 0), False
    raw = data.tobytes()
    if not 0 < n <= MOST_POINTS or len(raw) < _LENGTH.size:
        return nothing
    begin = _LENGTH.size + _LENGTH.unpack_from(raw)[0]
    if begin + _MOTION.size > len(raw) or begin < _LENGTH.size + _FIRST.size:
        return nothing
    (first,) = _FIRST.unpack_from(raw, _LENGTH.size)
    column = raw[_LENGTH.size + _FIRST.size : begin]
    time, sound = decode_residuals(np.zeros(n, np.bool_), 1, LEFT, _WIDTH, column)
    numbers = np.array(_MOTION.unpack_from(raw, begin))
    if not sound or not (np.abs(numbers) < _LARGEST).all():
        return nothing
    time = time + first
    s = timed_places(time, float(numbers[0]))
    body = np.ascontiguousarray(data[begin + _MOTION.size :])
    points, aimed, sound = read_body(
        n, layout, per, True, body, sensor, numbers[1:], read_rest, s, Clock.of(time), lists
    )
    return points, Timeline(lasers_of(aimed), time, 0, passed_of(body, lists)), sound


def body_of(data: bytes) -> bytes:
    """The body of :mod:`.aimed_points` in a body that :func:`write_moved` wrote."""
    return data[_LENGTH.size + _LENGTH.unpack_from(data)[0] + _MOTION.size :]
