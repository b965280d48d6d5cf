"""Points of a sweep as the sensors of the vehicle see them a sweep later: on which of their rays (:mod:`~salpcc.stages.lists.timed.turning_rays`), and how far away.

When a sensor looks at a point follows from the point's azimuth; where the sensor was then, from the motion. A reader repeats this, hence ``+ - * /`` and
square roots only.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.lattice.trig import TWO_PI, arctan2, sin_cos
from salpcc.stages.lattice.untwist import moved, turned_back
from salpcc.stages.lists.learned.moved_sweep import Turn, no_turn, turn_of
from salpcc.stages.lists.timed.turning_rays import Turning
from salpcc.stages.lists.timeline import LASERS

_APART = 2e-3  # radians; a point farther above or below a ray is not on it
_NEAREST, _FARTHEST = 0.1, 1e3  # metres

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]


class Eyes(NamedTuple):
    """Sensors that may see a point: the slope of each laser ``(L,)``; place, rotation and rate ``(G, 7)``, motion ``(6,)``; lasers by rising elevation ``(L,)``, those of each sensor from ``first (G + 1,)`` on; an azimuth of each sensor ``(G,)``."""

    slope: F64
    sensors: F64
    motion: F64
    lasers: I64
    first: I64
    azimuth: F64


def eyes_of(turning: Turning, group: I64) -> Eyes:
    """Return the sensors of rays; ``group``: that of each laser."""
    elevation = turning.lasers[:, 0].astype(np.float64)
    slope = np.array([sine / cosine for sine, cosine in map(sin_cos, elevation)])
    own = group[: len(elevation)]
    lasers = np.lexsort((slope, own))
    first = np.searchsorted(own[lasers], np.arange(len(turning.sensors) + 1))
    azimuth = np.zeros(len(turning.sensors))
    some = first[:-1] < first[1:]
    middle = lasers[(first[:-1][some] + first[1:][some]) // 2]
    azimuth[some] = turning.lasers[middle, 1]
    return Eyes(
        slope, turning.sensors.astype(np.float64), turning.motion.astype(np.float64), lasers, first, azimuth
    )


@njit(cache=True, error_model="numpy", _nrt=False)
def _seen_by(x: float, y: float, z: float, g: int, eyes: Eyes) -> tuple[int, float, float]:
    """Return the laser of sensor g that a point is on, -1: none; the azimuth of the ray to it, and 1/d."""
    s, m = eyes.sensors[g], eyes.motion
    turn = TWO_PI / abs(s[6])
    t = (arctan2(y - s[1], x - s[0]) - s[5] - eyes.azimuth[g]) / s[6]
    t -= turn * np.floor(t / turn + 0.5)
    motion = (m[0], m[1], m[2], m[3], m[4], m[5])
    a, b, c = turned_back(x, y, z, t, motion)
    a, b, c = turned_back(a, b, c, 1.0, (s[0], s[1], s[2], s[3], s[4], s[5]))
    slope = c / np.sqrt(a * a + b * b)
    low, high = eyes.first[g], eyes.first[g + 1]
    while low < high:
        middle = (low + high) >> 1
        if eyes.slope[eyes.lasers[middle]] < slope:
            low = middle + 1
        else:
            high = middle
    best, nearest = -1, _APART * (1.0 + slope * slope)
    for at in (low - 1, low):
        if eyes.first[g] <= at < eyes.first[g + 1]:
            off = abs(eyes.slope[eyes.lasers[at]] - slope)
            if off < nearest:
                best, nearest = eyes.lasers[at], off
    if best < 0:
        return -1, 0.0, 0.0
    a, b, c = moved(s[0], s[1], s[2], t, motion)
    a, b, c = x - a, y - b, z - c
    d = np.sqrt(a * a + b * b + c * c)
    return (best, arctan2(b, a), 1.0 / d) if _NEAREST < d < _FARTHEST else (-1, 0.0, 0.0)


@njit(cache=True, error_model="numpy")
def _seen(points: F32, between: F64, eyes: Eyes) -> tuple[I64, F64, F64, I64]:
    """Lasers, azimuths, 1/d and places of points ``(N, 3)`` as every sensor that turns sees them, after the motion ``between (6,)``."""
    m = (between[0], between[1], between[2], between[3], between[4], between[5])
    n, sensors = len(points), len(eyes.sensors)
    laser, place = np.empty(n * sensors, np.int64), np.empty(n * sensors, np.int64)
    azimuth, inverse = np.empty(n * sensors), np.empty(n * sensors)
    found = 0
    for g in range(sensors):
        if abs(eyes.sensors[g, 6]) < 1.0:
            continue
        for i in range(n):
            x, y, z = np.float64(points[i, 0]), np.float64(points[i, 1]), np.float64(points[i, 2])
            if not abs(x) + abs(y) + abs(z) < _FARTHEST:
                continue
            x, y, z = turned_back(x, y, z, 1.0, m)
            k, a, w = _seen_by(x, y, z, g, eyes)
            if k >= 0:
                laser[found], azimuth[found], inverse[found], place[found] = k, a, w, i
                found += 1
    return laser[:found], azimuth[:found], inverse[:found], place[:found]


class Swept(NamedTuple):
    """A sweep of sensors in motion: points ``(N, 3)`` as they become known, and the motion ``(6,)`` since the sweep before, as :func:`.find_between` has it."""

    points: F32
    between: NDArray[np.float32]


def swept_later(before: Swept | None, own: Swept, eyes: Eyes) -> Turn:
    """Return the points of the sweep before where the sensors see them in the course of ``own``; nothing where it is not known."""
    if before is None:
        return no_turn()
    laser, azimuth, inverse, places = _seen(before.points, own.between.astype(np.float64), eyes)
    return turn_of(laser, azimuth, inverse, places, LASERS)
