"""Measure points on the lattice: nearest return, and the corrections that give the point back exactly."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.lattice.lattice import correction_code, laser_constants, model_point, project_point
from salpcc.stages.lattice.order import azimuth_key
from salpcc.stages.lattice.sensor_model import SensorModel
from salpcc.stages.lattice.trig import turn_tables
from salpcc.stages.lattice.untwist import BLOCK

MAX_COUNT = (1 << 20) - 1


@njit(cache=True, error_model="numpy", inline="always")
def _ordered(bits: int) -> int:
    return bits ^ 0x7FFFFFFF if bits < 0 else bits


@njit(cache=True, error_model="numpy")
def _measure(  # type: ignore[no-untyped-def]
    parameters, count_size, turn, laser, raw, published, points
):
    sines, cosines = turn
    ticks = len(sines)
    constants = laser_constants(parameters)
    n = len(laser)
    tick = np.zeros(n, np.int32)
    count = np.zeros(n, np.int32)
    millimetre = np.empty(n, np.int8)
    ulp = np.empty(n, np.int8)
    key = np.empty(n)
    block = np.empty((5, BLOCK))
    x, y, z, t, r = block[0], block[1], block[2], block[3], block[4]
    start = 0
    while start < n:
        # A stretch of one laser, so that its constants are no columns; without a laser as if it were 0.
        size = 1
        while size < BLOCK and start + size < n and laser[start + size] == laser[start]:
            size += 1
        k = max(laser[start], 0)
        p = parameters[k, 0], parameters[k, 1], parameters[k, 2], parameters[k, 3], parameters[k, 4]
        c = constants[k, 0], constants[k, 1], constants[k, 2], constants[k, 3]
        for i in range(size):
            x[i], y[i], z[i] = raw[start + i, 0], raw[start + i, 1], raw[start + i, 2]
        for i in range(size):
            t[i], r[i] = project_point(x[i] / 1000.0, y[i] / 1000.0, z[i] / 1000.0, p, c, count_size, ticks)
        for i in range(size):
            tick[start + i], count[start + i] = t[i], min(max(r[i], -1.0), MAX_COUNT + 1.0)
        for i in range(size):
            x[i], y[i], z[i] = model_point(np.int32(t[i]), r[i], p, c, count_size, sines, cosines)
        for i in range(size):
            key[start + i] = azimuth_key(x[i], y[i])
        for i in range(size):
            at = start + i
            if laser[at] < 0 or count[at] < 0 or count[at] > MAX_COUNT:
                millimetre[at] = ulp[at] = -1
                continue
            millimetre[at] = correction_code(
                raw[at, 0] - np.int64(np.rint(x[i] * 1000.0)),
                raw[at, 1] - np.int64(np.rint(y[i] * 1000.0)),
                raw[at, 2] - np.int64(np.rint(z[i] * 1000.0)),
            )
            ulp[at] = correction_code(
                _ordered(np.int64(points[at, 0])) - _ordered(np.int64(published[at, 0])),
                _ordered(np.int64(points[at, 1])) - _ordered(np.int64(published[at, 1])),
                _ordered(np.int64(points[at, 2])) - _ordered(np.int64(published[at, 2])),
            )
        start += size
    return tick, count, millimetre, ulp, key


def measure(
    sensor: SensorModel,
    laser: NDArray[np.int64],
    raw: NDArray[np.int64],
    compensated: NDArray[np.float64],
    points: NDArray[np.float32],
) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int8], NDArray[np.int8], NDArray[np.float64]]:
    """Put points ``(N, 3)`` on the lattice of their lasers ``(N,)`` (-1: none).

    Args:
        raw, compensated: see :func:`salpcc.stages.lattice.untwist.untwist`.

    Returns:
        tick and count; codes of the 1 mm and of the float32 correction, -1 where there is none that
        would do; and the azimuth by which the file is sorted. All ``(N,)``.
    """
    published = compensated.astype(np.float32).view(np.int32)
    result: tuple[
        NDArray[np.int32], NDArray[np.int32], NDArray[np.int8], NDArray[np.int8], NDArray[np.float64]
    ] = _measure(
        sensor.parameters, sensor.count, turn_tables(sensor.ticks_per_turn), laser, raw, published,
        points.view(np.int32),
    )  # fmt: skip
    return result
