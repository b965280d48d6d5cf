"""How a sensor moved from one cloud to the next: found by where points of the one come to lie on surfaces of the other. A writer's part, which no reader repeats.

The later cloud is taken ring by ring: a point of the cloud before, moved, falls between two of its rings, and there between two points of each. On a plane
1/d is linear in direction, which tells how far before or behind the surface the point is; six numbers bring most points onto it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.lattice.untwist import turned_back

_SAMPLE = 2500  # points
_FEWEST = 300  # points that fall on a surface
_ROUNDS = 8
_REACH = 1.0  # metres from a surface; what is farther counts no more
_GAP = 0.03  # radians between points of a ring that have a surface between them
_ALIKE = 0.1  # of 1/d, that these may be apart
_STEPS = np.array([1e-2, 1e-2, 1e-2, 1e-3, 1e-3, 1e-3])
_SPEEDS = np.arange(-4.0, 4.01, 0.5)  # metres ahead from cloud to cloud, with which a search begins
_YAWS = np.arange(-0.06, 0.061, 0.02)  # radians
_BEGUN = 3  # of them
_BETTER = 0.9  # times as far off as a sensor that stands, or it stands

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]


class Rings(NamedTuple):
    """Points ``(N,)`` as seen from one place, ring by ring, each by rising azimuth: azimuth, elevation, 1/d; where rings begin ``(R + 1,)``, and their elevations, rising ``(R,)``."""

    azimuth: F64
    elevation: F64
    inverse: F64
    first: I64
    heights: F64


def rings_of(points: F64, laser: I64) -> Rings:
    """Return points ``(N, 3)`` of lasers ``(N,)`` as rings; what is no return is left out."""
    d = np.sqrt((points**2).sum(axis=1))
    sound = np.flatnonzero((d > 0.5) & (d < 1e3))
    x, y, z = points[sound].T
    elevation, laser = np.arctan2(z, np.hypot(x, y)), laser[sound]
    heights = np.array([np.median(elevation[laser == k]) for k in np.unique(laser)])
    rank = np.argsort(np.argsort(heights))[np.searchsorted(np.unique(laser), laser)]
    azimuth = np.arctan2(y, x)
    order = np.lexsort((azimuth, rank))
    first = np.searchsorted(rank[order], np.arange(len(heights) + 1))
    return Rings(azimuth[order], elevation[order], 1.0 / d[sound[order]], first, np.sort(heights))


@njit(cache=True)
def _on_ring(rings: Rings, k: int, azimuth: float) -> tuple[float, float, float]:
    """1/d and elevation of ring k at an azimuth, and how 1/d changes with it there; 1/d is 0 where it has no surface."""
    low, high = rings.first[k], rings.first[k + 1]
    end = high
    while low < high:
        middle = (low + high) >> 1
        if rings.azimuth[middle] < azimuth:
            low = middle + 1
        else:
            high = middle
    if low == rings.first[k] or low == end:
        return 0.0, 0.0, 0.0
    a, b = low - 1, low
    gap = rings.azimuth[b] - rings.azimuth[a]
    change = rings.inverse[b] - rings.inverse[a]
    if gap > _GAP or gap <= 0.0 or abs(change) > _ALIKE * rings.inverse[a]:
        return 0.0, 0.0, 0.0
    part = (azimuth - rings.azimuth[a]) / gap
    return (
        rings.inverse[a] + part * change,
        rings.elevation[a] + part * (rings.elevation[b] - rings.elevation[a]),
        change / gap,
    )


@njit(cache=True)
def _off(points: F64, motion: F64, rings: Rings, origin: F64) -> F64:
    """How far points ``(N, 3)``, once the motion ``(6,)`` is undone, are behind the surface that they fall on, metres; NaN where there is none."""
    m = (motion[0], motion[1], motion[2], motion[3], motion[4], motion[5])
    off = np.full(len(points), np.nan)
    for i in range(len(points)):
        x, y, z = turned_back(points[i, 0], points[i, 1], points[i, 2], 1.0, m)
        x, y, z = x - origin[0], y - origin[1], z - origin[2]
        ground = np.sqrt(x * x + y * y)
        azimuth, elevation = np.arctan2(y, x), np.arctan2(z, ground)
        k = np.searchsorted(rings.heights, elevation)
        if k == 0 or k == len(rings.heights):
            continue
        low, e_low, turn = _on_ring(rings, k - 1, azimuth)
        high, e_high, _ = _on_ring(rings, k, azimuth)
        if low == 0.0 or high == 0.0 or e_high - e_low < 1e-4:
            continue
        rise = (high - low) / (e_high - e_low)
        surface = low + rise * (elevation - e_low)
        if surface <= 1e-3:
            continue
        slope, aside = rise / surface, turn / (surface * np.cos(elevation))
        apart = np.sqrt(x * x + y * y + z * z) - 1.0 / surface
        off[i] = apart / np.sqrt(1.0 + slope * slope + aside * aside)
    return off


def _cost(off: F64) -> float:
    """How far points are off together: what is on no surface counts as what is far."""
    return float(np.minimum(np.nan_to_num(np.abs(off), nan=_REACH), _REACH).mean())


def find_between(before: F64, now: F64, laser: I64, origin: F64, guess: F64) -> F64:
    """Return the motion ``(6,)`` from the cloud of points ``before (M, 3)`` to that of ``now (N, 3)``, of lasers ``(N,)``, which a sensor at ``origin (3,)`` sees.

    A point p before is ``R(-w) (p - v)`` now. Zeros where the sensor stands, or nothing is found.

    Args:
        guess: ``(6,)`` where a search begins.
    """
    d = np.sqrt((before**2).sum(axis=1))
    sound = np.flatnonzero((d > 1.0) & (d < 1e3))
    rings = rings_of(now - origin, laser)
    still = np.zeros(6)
    if len(sound) < _FEWEST or len(rings.heights) < 4:
        return still
    some = before[np.random.default_rng(0).permutation(sound)[:_SAMPLE]]
    starts = [still, guess]
    starts += [np.array([speed, 0.0, 0.0, 0.0, 0.0, yaw]) for speed in _SPEEDS for yaw in _YAWS]
    costs = np.array([_cost(_off(some, start, rings, origin)) for start in starts])
    best, least = still, _BETTER * costs[0]
    for start in [starts[j] for j in np.argsort(costs, kind="stable")[:_BEGUN]]:
        found, cost = _nearer(some, start, rings, origin)
        if cost < least:
            best, least = found, cost
    return best


def _nearer(points: F64, motion: F64, rings: Rings, origin: F64) -> tuple[F64, float]:
    """Adjust a motion until points lie on surfaces; and how far they are off then."""
    for _ in range(_ROUNDS):
        off = _off(points, motion, rings, origin)
        near = np.abs(off) < _REACH
        if near.sum() < _FEWEST:
            break
        rows = np.empty((len(points), 6))
        for j, step in enumerate(_STEPS):
            other = motion.copy()
            other[j] += step
            rows[:, j] = (_off(points, other, rings, origin) - off) / step
        near &= np.isfinite(rows).all(axis=1) & (np.abs(rows[:, :3]) < 3.0).all(axis=1)
        scale = 3.0 * np.median(np.abs(off[near])) + 1e-4
        weight = 1.0 / (1.0 + (off[near] / scale) ** 2)
        left = rows[near].T @ (rows[near] * weight[:, None])
        right = rows[near].T @ (off[near] * weight)
        motion = motion - np.linalg.solve(left + 1e-6 * np.trace(left) * np.eye(6), right)
    return motion, _cost(_off(points, motion, rings, origin))
