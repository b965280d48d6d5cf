"""Measure points on the lattice: nearest return, and the correction that gives the point back exactly."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.lattice.lattice import correction_code, laser_constants, model_point
from salpcc.stages.lattice.order import azimuth_key
from salpcc.stages.lattice.sensor_model import SensorModel
from salpcc.stages.lattice.trig import TWO_PI, turn_tables
from salpcc.stages.lattice.untwist import BLOCK

MAX_COUNT = (1 << 20) - 1


# Of the arc tangent of 0..1, to 2e-8 (Abramowitz and Stegun 4.4.50).
_A = (1.0, -0.3333314528, 0.1999355085, -0.1420889944, 0.1065626393, -0.0752896400, 0.0429096138, -0.0161657367, 0.0028662257)  # fmt: skip


@njit(cache=True, error_model="numpy", inline="always")
def _lever_angle(h: float, r: float) -> float:
    """The angle by which a lever arm ``h`` turns what is seen ``r`` away along the beam, but near the axis; to 2e-8."""
    t = min(max(h / r, -1.0), 1.0)
    s = t * t
    return t * (
        _A[0]
        + s * (_A[1] + s * (_A[2] + s * (_A[3] + s * (_A[4] + s * (_A[5] + s * (_A[6] + s * (_A[7] + s * _A[8])))))))
    )  # fmt: skip


@njit(cache=True, error_model="numpy", inline="always")
def _nearest(x, y, z, azimuth, p, c, count_size, ticks):  # type: ignore[no-untyped-def]
    """:func:`~.lattice.project_point` of a point whose azimuth is known."""
    rho2 = x * x + y * y
    h = p[2]
    phi = azimuth - _lever_angle(h, np.sqrt(max(rho2 - h * h, 0.0)))
    turned = np.rint((phi - p[3]) / TWO_PI * ticks)
    tick = turned - ticks * np.floor(turned / ticks)
    d = np.sqrt(rho2) * c[0] + (z - p[1]) * c[1]
    return tick, np.rint((d - p[4]) / count_size)


@njit(cache=True, error_model="numpy")
def _measure(  # type: ignore[no-untyped-def]
    parameters, count_size, turn, laser, raw, azimuth
):
    sines, cosines = turn
    ticks = len(sines)
    constants = laser_constants(parameters)
    n = len(laser)
    tick = np.empty(n, np.int32)
    count = np.empty(n, np.int32)
    millimetre = np.empty(n, np.int8)
    key = np.empty(n)
    block = np.empty((5, BLOCK))
    x, y, z, t, r = block[0], block[1], block[2], block[3], block[4]
    start = 0
    while start < n:
        # A stretch of one laser, so that its constants are no columns; without a laser as if it were 0.
        size = 1
        while size < BLOCK and start + size < n and laser[start + size] == laser[start]:
            size += 1
        k = max(np.int64(laser[start]), 0)
        p = parameters[k, 0], parameters[k, 1], parameters[k, 2], parameters[k, 3], parameters[k, 4]
        c = constants[k, 0], constants[k, 1], constants[k, 2], constants[k, 3]
        for i in range(size):
            x[i], y[i], z[i] = raw[start + i, 0], raw[start + i, 1], raw[start + i, 2]
        for i in range(size):
            t[i], r[i] = _nearest(
                x[i] / 1000.0, y[i] / 1000.0, z[i] / 1000.0, azimuth[start + i], p, c, count_size, ticks
            )
        for i in range(size):
            tick[start + i], count[start + i] = t[i], min(max(r[i], -1.0), MAX_COUNT + 1.0)
        for i in range(size):
            x[i], y[i], z[i] = model_point(tick[start + i], r[i], p, c, count_size, sines, cosines)
        for i in range(size):
            key[start + i] = azimuth_key(x[i], y[i])
        for i in range(size):
            at = start + i
            code = correction_code(
                raw[at, 0] - np.int64(np.rint(x[i] * 1000.0)),
                raw[at, 1] - np.int64(np.rint(y[i] * 1000.0)),
                raw[at, 2] - np.int64(np.rint(z[i] * 1000.0)),
            )
            fits = (laser[at] >= 0) & (count[at] >= 0) & (count[at] <= MAX_COUNT)
            millimetre[at] = code if fits else -1
        start += size
    return tick, count, millimetre, key


def measure(
    sensor: SensorModel, laser: NDArray[np.int16], raw: NDArray[np.int32], azimuth: NDArray[np.float64]
) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int8], NDArray[np.float64]]:
    """Put points ``(N, 3)`` on the lattice of their lasers ``(N,)`` (-1: none).

    Args:
        raw, azimuth: see :class:`salpcc.stages.lattice.untwist.Untwisted`.

    Returns:
        tick and count; codes of the 1 mm correction, -1 where there is none that would do; and the azimuth by which the file is
        sorted. All ``(N,)``.
    """
    result: tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int8], NDArray[np.float64]] = _measure(
        sensor.parameters, sensor.count, turn_tables(sensor.ticks_per_turn), laser, raw, azimuth
    )
    return result
