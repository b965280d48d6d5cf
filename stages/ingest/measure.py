"""Measure points on the lattice: nearest return, and the corrections that give the point back exactly."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.ingest.lattice import correction_code, laser_constants, model_point, project_point
from salpcc.stages.ingest.order import azimuth_key
from salpcc.stages.ingest.sensor_model import SensorModel
from salpcc.stages.ingest.trig import turn_tables

MAX_COUNT = (1 << 20) - 1


@njit(cache=True, error_model="numpy")
def _ordered(bits: int) -> int:
    return bits ^ 0x7FFFFFFF if bits < 0 else bits


@njit(cache=True, error_model="numpy")
def _measure(  # type: ignore[no-untyped-def]
    parameters, count_size, ticks, laser, raw, published, points
):
    sines, cosines = turn_tables(ticks)
    constants = laser_constants(parameters)
    n = len(laser)
    tick = np.zeros(n, np.int32)
    count = np.zeros(n, np.int32)
    millimetre = np.full(n, -1, np.int8)
    ulp = np.full(n, -1, np.int8)
    key = np.zeros(n)
    for i in range(n):
        k = laser[i]
        if k < 0:
            continue
        t, c = project_point(
            raw[i, 0] / 1000.0, raw[i, 1] / 1000.0, raw[i, 2] / 1000.0,
            parameters[k], constants[k], count_size, ticks,
        )  # fmt: skip
        if c < 0 or c > MAX_COUNT:
            continue
        tick[i] = t
        count[i] = c
        x, y, z = model_point(t, float(c), parameters[k], constants[k], count_size, sines, cosines)
        millimetre[i] = correction_code(
            raw[i, 0] - np.int64(np.rint(x * 1000.0)),
            raw[i, 1] - np.int64(np.rint(y * 1000.0)),
            raw[i, 2] - np.int64(np.rint(z * 1000.0)),
        )
        ulp[i] = correction_code(
            _ordered(np.int64(points[i, 0])) - _ordered(np.int64(published[i, 0])),
            _ordered(np.int64(points[i, 1])) - _ordered(np.int64(published[i, 1])),
            _ordered(np.int64(points[i, 2])) - _ordered(np.int64(published[i, 2])),
        )
        key[i] = azimuth_key(x, y)
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
        raw, compensated: see :func:`salpcc.stages.ingest.untwist.untwist`.

    Returns:
        tick and count; codes of the 1 mm and of the float32 correction, -1 where there is none that
        would do; and the azimuth by which the file is sorted. All ``(N,)``.
    """
    published = compensated.astype(np.float32).view(np.int32)
    result: tuple[
        NDArray[np.int32], NDArray[np.int32], NDArray[np.int8], NDArray[np.int8], NDArray[np.float64]
    ] = _measure(
        sensor.parameters, sensor.count, sensor.ticks_per_turn, laser, raw, published,
        points.view(np.int32),
    )  # fmt: skip
    return result
