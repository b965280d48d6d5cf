"""Which laser measured each point of a scan, from file order and elevation alone.

Files of spinning sensors list one ring after the other, and the azimuth rises through each ring: a
ring ends where the azimuth falls back by more than half a turn. Which laser a ring belongs to, its
elevation cone tells.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.ingest.sensor_model import SensorModel

_NEAR = 0.01  # metres from the cone; rounding and calibration explain 1 mm, lasers are 20 mm apart at 3 m


@njit(cache=True)
def _nearest_laser(
    raw: NDArray[np.int64], tangent: NDArray[np.float64], z0: NDArray[np.float64], near: float
) -> NDArray[np.int64]:
    """Laser whose cone is vertically nearest to each point, -1 where none is within ``near``."""
    nearest = np.full(len(raw), -1, np.int64)
    guess = 0
    for i in range(len(raw)):
        x = raw[i, 0] / 1000.0
        y = raw[i, 1] / 1000.0
        z = raw[i, 2] / 1000.0
        rho = np.sqrt(x * x + y * y)
        # Most points belong to the laser of the point before.
        if abs(z - z0[guess] - rho * tangent[guess]) < 0.002:
            nearest[i] = guess
            continue
        best = near
        for k in range(len(tangent)):
            off = abs(z - z0[k] - rho * tangent[k])
            if off < best:
                best = off
                nearest[i] = k
        if nearest[i] >= 0:
            guess = nearest[i]
    return nearest


def _homogeneous_runs(label: NDArray[np.int64], first: int) -> list[tuple[int, int]]:
    """Cut a stretch that holds several rings where one label gives way to another.

    Happens when a ring is so short that the next one starts at a higher azimuth (cropped clouds).
    """
    known = label[label >= 0]
    if len(known) == 0:
        return []
    if (known == np.bincount(known).argmax()).mean() > 0.9:
        return [(first, first + len(label))]
    change = np.flatnonzero(np.diff(label) != 0) + 1
    bounds = [0, *change.tolist(), len(label)]
    return [(first + a, first + b) for a, b in pairwise(bounds)]


def assign_lasers(
    sensor: SensorModel, raw: NDArray[np.int64], usable: NDArray[np.bool_]
) -> NDArray[np.int64]:
    """Return the laser of each raw point ``(N, 3)`` mm as int64 ``(N,)``, -1 where it is none.

    Lasers never fall along the file, so that (laser, azimuth) is the file's order; whatever breaks
    that order is left to the strays. Points that are not ``usable`` get -1.
    """
    laser = np.full(len(raw), -1, np.int64)
    where = np.flatnonzero(usable)
    if len(where) == 0:
        return laser
    points = raw[where]
    azimuth = np.arctan2(points[:, 1], points[:, 0]) % (2 * np.pi)
    cuts = np.flatnonzero(np.diff(azimuth) < -np.pi) + 1
    nearest = _nearest_laser(points, np.tan(sensor.theta), sensor.z0, _NEAR)
    bounds = [0, *cuts.tolist(), len(points)]
    last = -1
    for begin, end in pairwise(bounds):
        for a, b in _homogeneous_runs(nearest[begin:end], begin):
            votes = nearest[a:b][nearest[a:b] >= 0]
            if len(votes) == 0:
                continue
            k = int(np.bincount(votes).argmax())
            if k >= last:
                laser[where[a:b]] = k
                last = k
    return laser
