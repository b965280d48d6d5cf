"""Point sets of the 3-D branch: farthest point sampling, nearest grouping, three-point interpolation.

Farthest point sampling is nested: its first 1,024 points are the farthest point sample of 1,024. So one
ordered sample serves every level of the branch (section IV, eqs. (5) to (8)).
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from salpcc.stages.segment.nearest import nearest

F32 = NDArray[np.float32]
I64 = NDArray[np.int64]

GROUP = 16  # points that are pooled into one of the next level
SHRINK = 4  # points of one level per point of the next
LEVELS = 3
_BUCKET = 64  # points that farthest point sampling skips together
_BATCH = 32  # buckets whose distances are told at once
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


def farthest_points(points: F32, count: int) -> NDArray[np.int64]:
    """Return places ``(count,)`` of the farthest point sample of ``points`` ``(P, 3)``, from point 0 on.

    Ties go to the lower place. Where there are fewer points than asked for, places repeat.
    """
    near = np.asarray(cKDTree(points, leafsize=_BUCKET).indices, np.int64)
    return _farthest(np.ascontiguousarray(points[near]), near, count)


@njit(cache=True)
def _farthest(points: F32, place: I64, count: int) -> NDArray[np.int64]:
    """Sample as :func:`farthest_points`; points come in an order that keeps neighbours together, with their places.

    A bucket of them is left alone where no point of its box is nearer to the newest than all of them already are to
    an older one. Rounding is monotonic, so the bound holds for the numbers computed, and the sample is the plain one's.
    """
    n = len(points)
    rows = (n + _BUCKET - 1) // _BUCKET
    buckets = (rows + _BATCH - 1) // _BATCH * _BATCH  # those beyond are empty
    low = np.full((3, buckets), np.float32(np.inf))
    high = np.full((3, buckets), np.float32(-np.inf))
    for b in range(rows):
        for axis in range(3):
            low[axis, b] = points[b * _BUCKET : (b + 1) * _BUCKET, axis].min()
            high[axis, b] = points[b * _BUCKET : (b + 1) * _BUCKET, axis].max()
    distance = np.full(n, np.float32(np.inf))
    reach = np.full(buckets, np.float32(-1.0))  # the largest distance in each bucket
    reach[:rows] = np.inf
    which = np.zeros(buckets, np.int64)  # the point that has it, of the lowest place
    first = np.zeros(buckets // _BATCH, np.int64)  # the bucket that has the largest of each batch
    away = np.empty(_BATCH, np.float32)
    chosen = np.zeros(count, np.int64)
    last = int(np.argmin(place))
    zero = np.float32(0.0)
    for k in range(1, count):
        px, py, pz = points[last, 0], points[last, 1], points[last, 2]
        for batch in range(len(first)):
            start = batch * _BATCH
            for i in range(_BATCH):
                dx = max(low[0, start + i] - px, px - high[0, start + i], zero)
                dy = max(low[1, start + i] - py, py - high[1, start + i], zero)
                dz = max(low[2, start + i] - pz, pz - high[2, start + i], zero)
                away[i] = dx * dx + dy * dy + dz * dz
            touched = False
            for b in range(start, start + _BATCH):
                if away[b - start] >= reach[b]:
                    continue
                touched = True
                best = np.float32(-1.0)
                at = 0
                for i in range(b * _BUCKET, min((b + 1) * _BUCKET, n)):
                    dx = points[i, 0] - px
                    dy = points[i, 1] - py
                    dz = points[i, 2] - pz
                    d = min(distance[i], dx * dx + dy * dy + dz * dz)
                    distance[i] = d
                    if d > best or (d == best and place[i] < place[at]):
                        best = d
                        at = i
                reach[b] = best
                which[b] = at
            if touched:
                first[batch] = _first(reach, which, place, np.arange(start, start + _BATCH))
        top = _first(reach, which, place, first)
        last = which[top]
        chosen[k] = place[last]
    return chosen


@njit(cache=True)
def _first(reach: F32, which: I64, place: I64, buckets: I64) -> int:
    """Return which of some ``buckets`` reaches farthest, by a point of the lowest place."""
    top = buckets[0]
    for b in buckets[1:]:
        if reach[b] > reach[top] or (reach[b] == reach[top] and place[which[b]] < place[which[top]]):
            top = b
    return top


def interpolate(points: F32, queries: F32) -> tuple[I64, F32]:
    """Return the three nearest of ``points`` ``(M, 3)`` to each query ``(Q, 3)`` and weights by inverse distance."""
    distance, places = nearest(points, queries, 3)
    inverse = np.float32(1.0) / (distance + np.float32(_FLOOR))
    return places, inverse / inverse.sum(axis=1, keepdims=True)


def sample(
    points: F32,
    queries: F32,
    count: int,
    rng: np.random.Generator | None = None,
    asked: NDArray[np.bool_] | None = None,
) -> PointSets:
    """Build the point sets of one image.

    Args:
        points: ``(N, 3)`` returns in the image; at least one.
        queries: ``(Q, 3)`` where features are wanted.
        count: points of the first level, a multiple of 16.
        rng: draws the first down-sampling; without it, it is evenly spread.
        asked: ``(Q,)`` which queries are; the others get weights of 0. By default all are.
    """
    wanted = count * SHRINK
    if rng is None:
        source = np.linspace(0, len(points) - 1, wanted).astype(np.int64)
    else:
        source = np.sort(rng.choice(len(points), wanted, replace=len(points) < wanted))
    taken = points[source]
    order = farthest_points(taken, count)
    centres = [order[: count // SHRINK**level] for level in range(LEVELS)]
    places = [taken, *(taken[chosen] for chosen in centres)]
    groups = [nearest(before, here, GROUP)[1] for before, here in itertools.pairwise(places)]
    parents, weights = zip(
        *(interpolate(after, here) for here, after in itertools.pairwise(places[1:])), strict=True
    )
    asked = np.ones(len(queries), np.bool_) if asked is None else asked
    pixel_parents = np.zeros((len(queries), 3), np.int64)
    pixel_weights = np.zeros((len(queries), 3), np.float32)
    pixel_parents[asked], pixel_weights[asked] = interpolate(places[1], queries[asked])
    return PointSets(source, tuple(centres), tuple(groups), parents, weights, pixel_parents, pixel_weights)
