"""Point sets of the 3-D branch: farthest point sampling, nearest grouping, three-point interpolation.

Farthest point sampling is nested: its first 1,024 points are the farthest point sample of 1,024. So one
ordered sample serves every level of the branch (section IV, eqs. (5) to (8)).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.spatial import cKDTree

F32 = NDArray[np.float32]
I64 = NDArray[np.int64]

GROUP = 16  # points that are pooled into one of the next level
SHRINK = 4  # points of one level per point of the next
LEVELS = 3
_FLOOR = 0.05  # metres added to distances, so that weights stay finite


@dataclass(frozen=True, eq=False)
class PointSets:
    """Indices of the 3-D branch for one image.

    Attributes:
        source: ``(P,)`` pixels (flat) that the first, random down-sampling took.
        centres: per level, places ``(M,)`` of its points in ``source``; each a prefix of the first.
        groups: per level, ``(M, 16)`` neighbours in the level before (``source`` for the first).
        parents, weights: per level but the last, ``(M, 3)`` points of the next level and their weights.
        pixel_parents, pixel_weights: ``(pixels, 3)`` of the first level for each queried pixel.
    """

    source: I64
    centres: tuple[I64, ...]
    groups: tuple[I64, ...]
    parents: tuple[I64, ...]
    weights: tuple[F32, ...]
    pixel_parents: I64
    pixel_weights: F32


@njit(cache=True)
def farthest_points(points: F32, count: int) -> NDArray[np.int64]:
    """Return places ``(count,)`` of the farthest point sample of ``points`` ``(P, 3)``, from point 0 on.

    Ties go to the lower place. Where there are fewer points than asked for, places repeat.
    """
    n = len(points)
    x = points[:, 0].copy()
    y = points[:, 1].copy()
    z = points[:, 2].copy()
    distance = np.full(n, np.float32(np.inf))
    chosen = np.zeros(count, np.int64)
    last = 0
    for k in range(1, count):
        px, py, pz = x[last], y[last], z[last]
        for i in range(n):
            dx = x[i] - px
            dy = y[i] - py
            dz = z[i] - pz
            distance[i] = min(distance[i], dx * dx + dy * dy + dz * dz)
        last = int(np.argmax(distance))
        chosen[k] = last
    return chosen


def interpolate(points: F32, queries: F32) -> tuple[I64, F32]:
    """Return the three nearest of ``points`` to each query ``(Q, 3)`` and weights by inverse distance."""
    distance, nearest = cKDTree(points).query(queries, k=3)
    inverse = 1.0 / (np.asarray(distance) + _FLOOR)
    weights = (inverse / inverse.sum(axis=1, keepdims=True)).astype(np.float32)
    return np.asarray(nearest, np.int64), weights


def sample(points: F32, queries: F32, count: int, rng: np.random.Generator | None = None) -> PointSets:
    """Build the point sets of one image.

    Args:
        points: ``(N, 3)`` returns in the image; at least one.
        queries: ``(Q, 3)`` where features are wanted.
        count: points of the first level, a multiple of 16.
        rng: draws the first down-sampling; without it, it is evenly spread.
    """
    wanted = count * SHRINK
    if rng is None:
        source = np.linspace(0, len(points) - 1, wanted).astype(np.int64)
    else:
        source = np.sort(rng.choice(len(points), wanted, replace=len(points) < wanted))
    taken = points[source]
    order = farthest_points(taken, count)
    centres, groups, parents, weights = [], [], [], []
    before = taken
    for level in range(LEVELS):
        chosen = order[: count // SHRINK**level]
        here = taken[chosen]
        groups.append(np.asarray(cKDTree(before).query(here, k=GROUP)[1], np.int64))
        if level:
            up = interpolate(here, before)
            parents.append(up[0])
            weights.append(up[1])
        centres.append(chosen)
        before = here
    pixels = interpolate(taken[order], queries)
    return PointSets(source, tuple(centres), tuple(groups), tuple(parents), tuple(weights), *pixels)
