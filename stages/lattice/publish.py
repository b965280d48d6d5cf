"""From lattice points to published points, with the two roundings on the way.

    model --1 mm rounding--> raw --motion--> compensated --float32 rounding--> published

The model and the motion explain nearly every rounding. A coordinate that was rounded the other way
lay close to the rounding boundary, so its correction is all but free for a coder that looks there:
both roundings come with their distance to the boundary.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.schemas.sweep import Sweep
from salpcc.stages.lattice.lattice import (
    NO_CORRECTION,
    beam_point,
    corrections,
    digits_of,
    laser_constants,
)
from salpcc.stages.lattice.sensor_model import SensorModel
from salpcc.stages.lattice.trig import TWO_PI, arctan2, turn_tables
from salpcc.stages.lattice.untwist import BLOCK, forward, moved, on_lattice

Column = NDArray[np.float64]


def ordered_bits(values: NDArray[np.float32]) -> NDArray[np.int64]:
    """Map float32 of any shape to integers in the order of the values, neighbours one apart (-0.0 is -1)."""
    bits = values.view(np.int32).astype(np.int64)
    return np.where(bits < 0, bits ^ 0x7FFFFFFF, bits)


def from_ordered_bits(bits: NDArray[np.int64]) -> NDArray[np.float32]:
    """Inverse of :func:`ordered_bits`."""
    return np.where(bits < 0, bits ^ 0x7FFFFFFF, bits).astype(np.int32).view(np.float32)


class Rounded(NamedTuple):
    """Points ``(M, 3)`` on their way from the model to the file.

    Attributes:
        model: float64, metres.
        millimetre: corrections of their rounding to 1 mm, uint8 ``(M,)``.
        motion: ``(6,)``, zeros without one.  moving: whether there is one.
    """

    model: NDArray[np.float64]
    millimetre: NDArray[np.uint8]
    motion: NDArray[np.float64]
    moving: bool


def rounded(
    model: NDArray[np.float64], millimetre: NDArray[np.uint8], motion: NDArray[np.float64] | None
) -> Rounded:
    """Put together what :func:`compensate` takes."""
    return Rounded(model, millimetre, np.zeros(6) if motion is None else motion, motion is not None)


@njit(cache=True, error_model="numpy", _nrt=False)
def compensate(given: Rounded, start: int, size: int, x: Column, y: Column, z: Column) -> None:
    """Round ``size`` points from ``start`` on to 1 mm, correct them, move them; coordinates go to short columns.

    KITTI stored raw points as float32 before it moved them, so does this.
    """
    model, motion = given.model, given.motion
    m = (motion[0], motion[1], motion[2], motion[3], motion[4], motion[5])
    for i in range(size):
        a, b, c = digits_of(np.int64(given.millimetre[start + i]))
        x[i] = on_lattice(model[start + i, 0], a)
        y[i] = on_lattice(model[start + i, 1], b)
        z[i] = on_lattice(model[start + i, 2], c)
    if given.moving:
        for i in range(size):
            x[i], y[i], z[i] = forward(x[i], y[i], z[i], m)


@njit(cache=True, error_model="numpy", nogil=True)
def _published(given: Rounded) -> NDArray[np.float32]:
    n = len(given.model)
    points = np.empty((n, 3), np.float32)
    block = np.empty((3, BLOCK))
    x, y, z = block[0], block[1], block[2]
    for start in range(0, n, BLOCK):
        size = min(BLOCK, n - start)
        compensate(given, start, size, x, y, z)
        for i in range(size):
            points[start + i, 0], points[start + i, 1], points[start + i, 2] = x[i], y[i], z[i]
    return points


def published_points(given: Rounded) -> NDArray[np.float32]:
    """Return the points ``(M, 3)`` compensated and rounded to float32, their last bits not corrected."""
    points: NDArray[np.float32] = _published(given)
    return points


def _patched(points: NDArray[np.float32], ulp: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Correct the last bits of points ``(M, 3)`` in place."""
    wrong = np.flatnonzero(ulp != NO_CORRECTION)
    points[wrong] = from_ordered_bits(ordered_bits(points[wrong]) + corrections(ulp[wrong]))
    return points


@njit(cache=True, error_model="numpy", nogil=True)
def _told(  # type: ignore[no-untyped-def]
    parameters, count_size, turn, laser, tick, count, step, exact, millimetre, motion, moving
) -> tuple[NDArray[np.float32], Column]:
    """Points and azimuths of returns in one pass, block by block of a ring: what :mod:`.lattice`, :mod:`.order` and this module say of them, in turn."""
    sines, cosines = turn
    last = np.uint32(len(sines) - 1)
    constants = laser_constants(parameters)
    m = (motion[0], motion[1], motion[2], motion[3], motion[4], motion[5])
    n = len(laser)
    points, keys = np.empty((n, 3), np.float32), np.empty(n)
    block = np.empty((6, BLOCK))
    x, y, z, s, sine, cosine = block[0], block[1], block[2], block[3], block[4], block[5]
    end = 0
    while end < n:
        start = end
        k = laser[start]
        end = start + np.searchsorted(laser[start : start + BLOCK], k, "right")
        p = (parameters[k, 0], parameters[k, 1], parameters[k, 2], parameters[k, 3], parameters[k, 4])
        c = (constants[k, 0], constants[k, 1], constants[k, 2], constants[k, 3])
        # Loops over slices, and one thing a loop, become vector instructions.
        ticks, counts = tick[start:end], count[start:end]
        for i in range(end - start):
            at = np.uint64(min(np.uint32(ticks[i]), last))  # what is no tick must not lead out of the tables
            sine[i], cosine[i] = sines[at], cosines[at]
        for i in range(end - start):
            middle = np.float64(counts[i]) * step + (step - 1) / 2
            x[i], y[i], z[i] = beam_point(sine[i], cosine[i], middle, p, c, count_size)
        for i in range(end - start):
            s[i] = arctan2(y[i], x[i])
        key = keys[start:end]
        for i in range(end - start):
            key[i] = s[i] + TWO_PI if s[i] < 0.0 else s[i]
        if exact:
            codes = millimetre[start:end]
            for i in range(end - start):
                dx, dy, dz = digits_of(np.int64(codes[i]))
                x[i], y[i], z[i] = on_lattice(x[i], dx), on_lattice(y[i], dy), on_lattice(z[i], dz)
            if moving:
                for i in range(end - start):
                    x[i], y[i], z[i] = forward(x[i], y[i], z[i], m)
        elif moving:
            for i in range(end - start):
                x[i], y[i], z[i] = moved(x[i], y[i], z[i], s[i] / TWO_PI, m)
        put = points[start:end]
        for i in range(end - start):
            put[i, 0], put[i, 1], put[i, 2] = x[i], y[i], z[i]
    return points, keys


def points_and_keys(sweep: Sweep, sensor: SensorModel) -> tuple[NDArray[np.float32], Column]:
    """Return the points ``(M, 3)`` of a sweep's returns in firing order, as published or within its error, and their :func:`~.order.azimuth_key` ``(M,)``."""
    exact = sweep.max_error == 0
    motion = np.zeros(6) if sweep.motion is None else sweep.motion
    points, keys = _told(
        sensor.parameters, sensor.count, turn_tables(sensor.ticks_per_turn), sweep.laser, sweep.tick, sweep.count,
        sweep.step, exact, sweep.millimetre, motion, sweep.motion is not None,
    )  # fmt: skip
    return (_patched(points, sweep.ulp) if exact else points), keys


@njit(cache=True, error_model="numpy", _nrt=False, inline="always")
def millimetre_boundary(value: float) -> tuple[float, float]:
    """Distance in mm of a coordinate in metres to the nearest rounding boundary, and the step across it, +1 or -1."""
    v = value * 1000.0
    off = v - np.rint(v)
    return 0.5 - abs(off), 1.0 if off > 0.0 else -1.0


@njit(cache=True, error_model="numpy", _nrt=False, inline="always")
def float32_boundary(value: float) -> tuple[float, float]:
    """Distance in nanometres of a coordinate in metres to the nearest float32 rounding boundary, and the step across it."""
    nearest = np.float32(value)
    size = np.int32(nearest.view(np.int32) & np.int32(0x7FFFFFFF))
    after = np.int32(size + np.int32(1)).view(np.float32)
    off = value - np.float64(nearest)
    half = np.float64(after - size.view(np.float32)) * 0.5
    return (half - abs(off)) * 1e9, 1.0 if off > 0.0 else -1.0
