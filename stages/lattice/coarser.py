"""How far returns move that are given back from coarser counts: a bound that is cheap, and the azimuths that order both in the file."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.schemas.sweep import Sweep
from salpcc.stages.lattice.lattice import NO_CORRECTION, laser_constants, model_point
from salpcc.stages.lattice.order import azimuth_key
from salpcc.stages.lattice.sensor_model import SensorModel
from salpcc.stages.lattice.trig import turn_tables
from salpcc.stages.lattice.untwist import BLOCK

Column = NDArray[np.float64]

# Half the diagonal of the 1 mm cube that a published point was rounded in before it was moved.
ROUNDING = 0.000867
# Both points are float32, one of them with last bits corrected by up to one: of a coordinate, two of its last bits.
_LAST_BITS = 2.0**-21


@njit(cache=True, error_model="numpy", nogil=True)
def _coarser(  # type: ignore[no-untyped-def]
    parameters, count_size, turn, laser, tick, count, level, step, millimetre, speed, turning, most
):
    sines, cosines = turn
    ticks = len(sines)
    constants = laser_constants(parameters)
    n = len(laser)
    near, keys = np.empty(n, np.bool_), np.empty(n)
    coarse_keys = keys if step == 1 else np.empty(n)
    block = np.empty((6, BLOCK))
    x, y, z, cx, cy, cz = block[0], block[1], block[2], block[3], block[4], block[5]
    for start in range(0, n, BLOCK):
        size = min(BLOCK, n - start)
        for i in range(size):
            k, t = laser[start + i], tick[start + i] % ticks
            fine = np.float64(count[start + i])
            x[i], y[i], z[i] = model_point(t, fine, parameters[k], constants[k], count_size, sines, cosines)
        for i in range(size):
            keys[start + i] = azimuth_key(x[i], y[i])
        if step == 1:
            cx[:size], cy[:size], cz[:size] = x[:size], y[:size], z[:size]
        else:
            for i in range(size):
                k, t = laser[start + i], tick[start + i] % ticks
                middle = np.float64(level[start + i]) * step + (step - 1) / 2
                cx[i], cy[i], cz[i] = model_point(
                    t, middle, parameters[k], constants[k], count_size, sines, cosines
                )
            for i in range(size):
                coarse_keys[start + i] = azimuth_key(cx[i], cy[i])
        for i in range(size):
            dx, dy, dz = x[i] - cx[i], y[i] - cy[i], z[i] - cz[i]
            off = np.sqrt(dx * dx + dy * dy + dz * dz) + ROUNDING
            rho, coarse_rho = np.sqrt(x[i] * x[i] + y[i] * y[i]), np.sqrt(cx[i] * cx[i] + cy[i] * cy[i])
            far = rho + abs(z[i]) + off
            # Seen apart by an angle of at most aside / rho * pi / 2, so by that much of the motion of 2 pi more or less.
            aside = abs(x[i] * cy[i] - y[i] * cx[i]) / coarse_rho + ROUNDING
            bound = off + aside * (speed + turning * far) * 0.25 / rho + (far + speed) * _LAST_BITS
            # Behind, where the turn ends and begins, the one may be of the end, the other of the beginning.
            apart = (x[i] < off) & (abs(y[i]) <= off)
            plain = millimetre[start + i] == NO_CORRECTION
            near[start + i] = (bound <= most) & (rho > off) & ~apart & plain
    return near, keys, coarse_keys


def coarser(
    sweep: Sweep, coarse: Sweep, sensor: SensorModel, max_error: float
) -> tuple[NDArray[np.bool_], Column, Column]:
    """Compare returns ``(M,)`` of a lossless sweep with those of the same sweep at coarser counts.

    Returns:
        which are surely not farther than ``max_error`` metres from each other, as published: the motion moves both alike, but for the
        little that they are seen apart; and their :func:`~.order.azimuth_key`, of the one and of the other.
    """
    motion = np.zeros(6) if sweep.motion is None else sweep.motion
    speed, turning = float(np.sqrt((motion[:3] ** 2).sum())), float(np.sqrt((motion[3:] ** 2).sum()))
    result: tuple[NDArray[np.bool_], Column, Column] = _coarser(
        sensor.parameters, sensor.count, turn_tables(sensor.ticks_per_turn), sweep.laser, sweep.tick, sweep.count,
        coarse.count, coarse.step, sweep.millimetre, speed, turning, max_error,
    )  # fmt: skip
    return result
