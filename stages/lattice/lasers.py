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

from salpcc.stages.lattice.sensor_model import SensorModel

_NEAR = 0.01  # metres from the cone; rounding and calibration explain 1 mm, lasers are 20 mm apart at 3 m


@njit(cache=True)
def _nearest_laser(
    raw: NDArray[np.int64], usable: NDArray[np.bool_], tangent: NDArray[np.float64], z0: NDArray[np.float64]
) -> NDArray[np.int16]:
    """Laser whose cone is vertically nearest to each usable point, -1 where none is near."""
    nearest = np.full(len(raw), -1, np.int16)
    guess = 0
    for i in range(len(raw)):
        if not usable[i]:
            continue
        x = raw[i, 0] / 1000.0
        y = raw[i, 1] / 1000.0
        z = raw[i, 2] / 1000.0
        rho = np.sqrt(x * x + y * y)
        # Most points belong to the laser of the point before.
        if abs(z - z0[guess] - rho * tangent[guess]) < 0.002:
            nearest[i] = guess
            continue
        best = _NEAR
        for k in range(len(tangent)):
            off = abs(z - z0[k] - rho * tangent[k])
            if off < best:
                best = off
                nearest[i] = k
        if nearest[i] >= 0:
            guess = int(np.int64(nearest[i]))
    return nearest


@njit(cache=True)
def _turns(raw: NDArray[np.int64], usable: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Where the azimuth in [0, 2 pi) of a usable point is more than half a turn below that of the one before."""
    cuts = []
    x = y = np.int64(0)
    for i in range(len(raw)):
        if usable[i]:
            # Into the upper half plane, and left of the line from the point before through the origin.
            if y < 0 and raw[i, 1] >= 0 and x * raw[i, 1] - y * raw[i, 0] > 0:
                cuts.append(i)
            x, y = raw[i, 0], raw[i, 1]
    return np.array(cuts, np.int64)


@njit(cache=True)
def _vote(label: NDArray[np.int16], lasers: int) -> tuple[int, int, int]:
    """The commonest label (the lowest of equals), how many have it, and how many have any."""
    counts = np.zeros(lasers, np.int64)
    for i in range(len(label)):
        if label[i] >= 0:
            counts[label[i]] += 1
    return int(counts.argmax()), int(counts.max()), int(counts.sum())


def _runs(label: NDArray[np.int16], first: int) -> list[tuple[int, int]]:
    """Cut a stretch that holds several rings where one label gives way to another.

    Happens when a ring is so short that the next one starts at a higher azimuth (cropped clouds).
    """
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
    nearest = _nearest_laser(raw, usable, np.tan(sensor.theta), sensor.z0)
    last = -1
    for begin, end in pairwise([0, *_turns(raw, usable).tolist(), len(raw)]):
        _, most, known = _vote(nearest[begin:end], sensor.n_lasers)
        runs = [(begin, end)] if most > 0.9 * known else _runs(nearest[begin:end], begin)
        for a, b in runs:
            k, votes, _ = _vote(nearest[a:b], sensor.n_lasers)
            if votes and k >= last:
                laser[a:b] = k
                last = k
    laser[~usable] = -1
    return laser
