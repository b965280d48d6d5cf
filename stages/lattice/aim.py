"""Any point on the lattice of a known sensor: the laser, tick and count that come nearest to it, and the point that they make.

:mod:`~salpcc.stages.lattice.measure` does this for files of rings on a 1 mm grid; here points are floats in any order.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.lattice.lattice import driven, laser_constants, model_point, project_point
from salpcc.stages.lattice.sensor_model import SensorModel
from salpcc.stages.lattice.trig import turn_tables

_SAMPLE = 2000  # points
_FIRST_LOOK, _HARDLY = 100, 0.1  # points of which hardly any lies on a lattice that is not theirs
_UNROUNDED = 5e-5  # metres

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Placed:
    """Which of points ``(N,)`` have known places on a lattice, as :func:`aim` finds them, and these: laser, tick and count ``(N,)``."""

    known: NDArray[np.bool_]
    laser: NDArray[np.uint8]
    tick: I64
    count: I64


@njit(cache=True, error_model="numpy")
def _nearest(z, rho, parameters, constants, tangent, order, wide, least):  # type: ignore[no-untyped-def]
    """The laser whose cone is nearest to a point, the first of several.

    Args:
        order: lasers by rising ``tangent`` of elevation.
        wide: metres that no cone's apex is farther from the origin than.
        least: cosine of any elevation.
    """
    # From the cone of this slope outwards, both ways, as far as any could be nearer.
    low, high = 0, len(order)
    while low < high:
        middle = (low + high) >> 1
        if rho * tangent[order[middle]] < z:
            low = middle + 1
        else:
            high = middle
    nearest, best = np.inf, np.int64(-1)
    for way in (-1, 1):
        at = low - 1 if way < 0 else low
        while 0 <= at < len(order):
            k = order[at]
            slope = abs(z - rho * tangent[k])
            apart = abs(z - parameters[k, 1] - rho * tangent[k]) * constants[k, 0]
            if apart < nearest or (apart == nearest and k < best):
                nearest, best = apart, k
            elif (slope - wide) * least > nearest * 1.000001:
                break
            at += way
    return best


@njit(cache=True, error_model="numpy")
def _aim(parameters, count_size, turn, points, known, laser, tick, count):  # type: ignore[no-untyped-def]
    constants = laser_constants(parameters)
    sines, cosines = turn
    ticks = len(sines)
    tangent = constants[:, 1] / constants[:, 0]
    order, wide, least = np.argsort(tangent), np.abs(parameters[:, 1]).max(), constants[:, 0].min()
    off = np.full(len(points), np.inf)
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        rho = np.sqrt(x * x + y * y)
        if not (0.0 < rho < 1e4 and abs(z) < 1e4):
            laser[i], tick[i], count[i] = -1, 0, 0
            continue
        if laser[i] < 0:
            laser[i] = _nearest(z, rho, parameters, constants, tangent, order, wide, least)
        k = laser[i]
        if not known[i]:
            t, c = project_point(x, y, z, parameters[k], constants[k], count_size, ticks)
            tick[i], count[i] = np.int64(t) % ticks, np.int64(c)
        a, b, d = model_point(
            tick[i], np.float64(count[i]), parameters[k], constants[k], count_size, sines, cosines
        )
        off[i] = np.sqrt((a - x) * (a - x) + (b - y) * (b - y) + (d - z) * (d - z))
    return off


def aim(
    sensor: SensorModel, points: F64, laser: I64 | None = None, placed: Placed | None = None
) -> tuple[I64, I64, I64, F64]:
    """Return the nearest laser, tick and count ``(N,)`` of points ``(N, 3)`` in metres, and how far their model point is.

    Points that are not finite, on the axis or beyond 10 km have laser -1 and are infinitely far.

    Args:
        laser: ``(N,)``, where it is known; -1 where not. Without it, the laser whose cone is nearest.
        placed: what was found of these points before.
    """
    n = len(points)
    chosen = np.full(n, -1) if laser is None else laser.copy()
    known, tick, count = np.zeros(n, np.bool_), np.zeros(n, np.int64), np.zeros(n, np.int64)
    if placed is not None:
        known, tick, count = placed.known, placed.tick.copy(), placed.count.copy()
        chosen = np.where(known, placed.laser.astype(np.int64), -1)
    turn = turn_tables(sensor.ticks_per_turn)
    off = _aim(sensor.parameters, sensor.count, turn, points, known, chosen, tick, count)
    return chosen, tick, count, off


def lies_on(sensor: SensorModel, points: NDArray[np.float32], within: float = _UNROUNDED) -> bool:
    """Tell whether most returns of ``points (N, 3)`` lie so close to the lattice; as computed from it, neither rounded nor moved."""
    first = _offsets(sensor, points, _FIRST_LOOK)
    if len(first) > _FIRST_LOOK // 10 and (first < within).mean() < _HARDLY:
        return False
    return share_on(sensor, points, within) > 0.5


def share_on(sensor: SensorModel, points: NDArray[np.float32], within: float = _UNROUNDED) -> float:
    """Share of the returns among ``points (N, 3)`` that lie so close to the lattice, from a sample; 0 for too few."""
    off = _offsets(sensor, points, _SAMPLE)
    return float((off < within).mean()) if len(off) > _SAMPLE // 10 else 0.0


def _offsets(sensor: SensorModel, points: NDArray[np.float32], many: int) -> F64:
    """How far the returns among about ``many`` of the points are from the lattice."""
    sample = points[:: len(points) // many + 1].astype(np.float64)
    return aim(sensor, sample[np.abs(sample).max(axis=1, initial=0.0) > 0])[3]


def given_back(
    sensor: SensorModel, points: NDArray[np.float32], laser: I64 | None = None
) -> NDArray[np.bool_]:
    """Mark the points ``(N, 3)`` that the model makes of their laser, tick and count bit for bit; ``laser`` as for :func:`aim`."""
    laser, tick, count, _ = aim(sensor, points.astype(np.float64), laser)
    known = np.maximum(laser, 0).astype(np.uint8)
    model = driven(sensor, known, tick.astype(np.int32), count.astype(np.float64)).astype(np.float32)
    same: NDArray[np.bool_] = (model.view(np.int32) == points.view(np.int32)).all(axis=1)
    return same & (laser >= 0)
