"""Which laser measured each point of a scan, from file order and elevation alone.

Files of spinning sensors list one ring after the other, and the azimuth rises through each ring: a
ring ends where the azimuth falls back by more than half a turn. Which laser a ring belongs to, its
elevation cone tells.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.lattice.sensor_model import SensorModel
from salpcc.stages.lattice.untwist import BLOCK

_NEAR = 0.01  # metres from the cone; rounding and calibration explain 1 mm, lasers are 20 mm apart at 3 m


@njit(cache=True)
def _nearest_laser(
    raw: NDArray[np.int32], usable: NDArray[np.bool_], tangent: NDArray[np.float64], z0: NDArray[np.float64]
) -> NDArray[np.int16]:
    """Laser whose cone is vertically nearest to each usable point, -1 where none is near."""
    n = len(raw)
    nearest = np.full(n, -1, np.int16)
    block = np.empty((4, BLOCK))
    x, y, z, rho = block[0], block[1], block[2], block[3]
    guess = 0
    for start in range(0, n, BLOCK):
        size = min(BLOCK, n - start)
        for i in range(size):
            x[i], y[i], z[i] = raw[start + i, 0], raw[start + i, 1], raw[start + i, 2]
        for i in range(size):
            x[i], y[i], z[i] = x[i] / 1000.0, y[i] / 1000.0, z[i] / 1000.0
            rho[i] = np.sqrt(x[i] * x[i] + y[i] * y[i])
        for i in range(size):
            if not usable[start + i]:
                continue
            # Most points belong to the laser of the point before.
            if abs(z[i] - z0[guess] - rho[i] * tangent[guess]) < 0.002:
                nearest[start + i] = guess
                continue
            best, found = _NEAR, -1
            for k in range(len(tangent)):
                off = abs(z[i] - z0[k] - rho[i] * tangent[k])
                if off < best:
                    best, found = off, k
            if found >= 0:
                nearest[start + i] = guess = found
    return nearest


@njit(cache=True)
def _turns(raw: NDArray[np.int32], usable: NDArray[np.bool_]) -> NDArray[np.int64]:
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


@njit(cache=True)
def _name(
    nearest: NDArray[np.int16], begin: int, end: int, lasers: int, last: int, laser: NDArray[np.int16]
) -> int:
    """Name the points of a stretch by what most are nearest to, unless lasers fell; return the laser named last."""
    k, votes, _ = _vote(nearest[begin:end], lasers)
    if votes == 0 or k < last:
        return last
    laser[begin:end] = k
    return k


@njit(cache=True)
def _assigned(
    nearest: NDArray[np.int16], usable: NDArray[np.bool_], cuts: NDArray[np.int64], lasers: int
) -> NDArray[np.int16]:
    n = len(nearest)
    laser = np.full(n, -1, np.int16)
    begin, last = 0, -1
    for end in np.append(cuts, n):
        _, most, known = _vote(nearest[begin:end], lasers)
        if most > 0.9 * known:
            last = _name(nearest, begin, end, lasers, last, laser)
        else:
            # Several rings, cut where one label gives way to another: one was so short that the next started at a higher azimuth
            # (cropped clouds).
            for at in range(begin + 1, end + 1):
                if at == end or nearest[at] != nearest[begin]:
                    last = _name(nearest, begin, at, lasers, last, laser)
                    begin = at
        begin = end
    for i in range(n):
        if not usable[i]:
            laser[i] = -1
    return laser


def assign_lasers(
    sensor: SensorModel, raw: NDArray[np.int32], usable: NDArray[np.bool_]
) -> NDArray[np.int16]:
    """Return the laser of each raw point ``(N, 3)`` mm as int16 ``(N,)``, -1 where it is none.

    Lasers never fall along the file, so that (laser, azimuth) is the file's order; whatever breaks
    that order is left to the strays. Points that are not ``usable`` get -1.
    """
    nearest = _nearest_laser(raw, usable, np.tan(sensor.theta), sensor.z0)
    result: NDArray[np.int16] = _assigned(nearest, usable, _turns(raw, usable), sensor.n_lasers)
    return result
