"""The sweep before, seen from the current one: its decoded returns moved by the known motion.

Both sweeps were compensated to their own middle, by motions ``(v, w)`` per turn that the archive holds, so half
of each lies between the two middles; from there the current motion is undone, as if the current sensor had
measured the points. They are then sorted into rows by the laser whose cone is nearest, by azimuth within
a row: several depths at an occlusion stand side by side. Decoders repeat this: see :mod:`.range_features`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.schemas.sweep import Sweep
from salpcc.stages.lattice.lattice import unproject
from salpcc.stages.lattice.sensor_model import SensorModel
from salpcc.stages.lattice.trig import TWO_PI, arctan2, sin_cos
from salpcc.stages.lattice.untwist import inverse, moved, twist
from salpcc.stages.predict.hundredths import intensity_levels
from salpcc.stages.predict.ring_rows import PAD, SLACK
from salpcc.stages.predict.sweep_walk import TICKS

UNKNOWN_INTENSITY = 25

F32 = NDArray[np.float32]


class WarpedSweep(NamedTuple):
    """A sweep as another one sees it, in rows like rings, each at ``[PAD, PAD + number)``, margins cyclic; kernels take it.

    Attributes:
        number: ``(L,)`` int64 points of each row.
        azimuth: ``(L, size)`` in ticks, without lever arm, rising; inverse: 1 / rho', 1/m; height: z / rho';
        intensity: hundredths; cones: of the sensor, see :func:`cones`.
    """

    number: NDArray[np.int64]
    azimuth: F32
    inverse: F32
    height: F32
    intensity: F32
    cones: F32


@njit(cache=True, error_model="numpy", nogil=True)
def _seen(points, laser, motion_before, motion, parameters, tangent):  # type: ignore[no-untyped-def]
    """Row, azimuth in ticks, inverse range and height of each compensated point of the sweep before."""
    n = len(points)
    row = np.full(n, -1, np.int64)
    seen = np.zeros((3, n), np.float32)
    lasers = len(tangent)
    for i in range(n):
        x, y, z = _later(points[i, 0], points[i, 1], points[i, 2], motion_before)
        x, y, z = _later(x, y, z, motion)
        rho2 = x * x + y * y
        if not (0.25 < rho2 < 1e8):
            continue
        x, y, z = inverse(x, y, z, motion, 0)
        rho = np.sqrt(x * x + y * y)
        if not (0.5 < rho < 1e4):
            continue
        turn = arctan2(y, x) * (TICKS / TWO_PI)
        seen[0, i] = turn + TICKS if turn < 0.0 else turn + 0.0  # no -0.0
        seen[1, i] = 1.0 / rho
        seen[2, i] = z / rho
        k = np.int64(laser[i])
        off = abs(z - parameters[k, 1] - rho * tangent[k])
        for way in (-1, 1):
            while 0 <= k + way < lasers:
                next_off = abs(z - parameters[k + way, 1] - rho * tangent[k + way])
                if next_off >= off:
                    break
                off = next_off
                k += way
        row[i] = k
    return row, seen


@njit(cache=True, error_model="numpy")
def _later(x: float, y: float, z: float, m: NDArray[np.float64]) -> tuple[float, float, float]:
    """Move a point into the frame that the vehicle has half a turn later.

    The sensor turns clockwise, so the turn's fraction ``s``, an azimuth, falls as time goes on.
    """
    return moved(x, y, z, 0.5, m)


@njit(cache=True, error_model="numpy", nogil=True)
def _rows(order, row, seen, intensity, lasers):  # type: ignore[no-untyped-def]
    """Lay out points, given by row and azimuth in ``order``; fill the margins."""
    number = np.zeros(lasers, np.int64)
    for i in order:
        number[row[i]] += 1
    rows = np.zeros((4, lasers, np.max(number) + 2 * PAD + SLACK), np.float32)
    fill = np.full(lasers, PAD)
    for i in order:
        k = row[i]
        for c in range(3):
            rows[c, k, fill[k]] = seen[c, i]
        rows[3, k, fill[k]] = intensity[i]
        fill[k] += 1
    for k in range(lasers):
        m = number[k]
        if m == 0:
            continue
        for p in range(PAD):
            left, right = PAD + m - 1 - p % m, PAD + p % m
            for c in range(4):
                rows[c, k, PAD - 1 - p] = rows[c, k, left]
                rows[c, k, PAD + m + p] = rows[c, k, right]
            turns = np.float32(1 + p // m) * np.float32(TICKS)
            rows[0, k, PAD - 1 - p] -= turns
            rows[0, k, PAD + m + p] += turns
    return number, rows


@njit(cache=True, error_model="numpy")
def _cones(parameters: NDArray[np.float64]) -> F32:
    lasers = len(parameters)
    out = np.zeros((lasers, 3), np.float32)
    for k in range(lasers):
        sine, cosine = sin_cos(parameters[k, 0])
        out[k, 0] = parameters[k, 1]
        out[k, 1] = sine / cosine
    for k in range(lasers):
        a, b = max(k - 1, 0), min(max(k, 1), lasers - 1)
        out[k, 2] = np.float32(1.0) / max(out[a, 1] - out[b, 1], np.float32(1e-3))
    return out


def cones(sensor: SensorModel) -> F32:
    """Return ``(L, 3)``: apex in metres, tangent of the elevation, 1 / its distance to the laser above."""
    return _cones(sensor.parameters)


def warp(before: Sweep | None, motion: NDArray[np.float64] | None, sensor: SensorModel) -> WarpedSweep:
    """Move the returns of the sweep before into the lattice of a sweep compensated with ``motion``.

    Without a sweep before, or where one of the two motions is not known, the rows are empty.
    """
    if before is None or before.motion is None or motion is None:
        none = np.zeros((sensor.n_lasers, 2 * PAD + SLACK), np.float32)
        return WarpedSweep(np.zeros(sensor.n_lasers, np.int64), none, none, none, none, cones(sensor))
    middles = before.count.astype(np.float64) * before.step + (before.step - 1) / 2
    values = intensity_levels(before.intensity)
    if values is None:
        values = np.full(len(before.laser), UNKNOWN_INTENSITY, np.uint8)
    points = twist(unproject(sensor, before.laser, before.tick, middles), before.motion)
    tangent = cones(sensor)[:, 1].astype(np.float64)
    row, seen = _seen(points, before.laser, before.motion, motion, sensor.parameters, tangent)
    # Bits of floats that are not negative rise with them.
    order = np.argsort(row << 32 | seen[0].view(np.int32), kind="stable")
    number, rows = _rows(order[np.searchsorted(row[order], 0) :], row, seen, values, sensor.n_lasers)
    return WarpedSweep(number, rows[0], rows[1], rows[2], rows[3], cones(sensor))
