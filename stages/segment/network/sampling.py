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

from salpcc.stages.segment.network.nearest import nearest, three_nearest

F32 = NDArray[np.float32]
I32 = NDArray[np.int32]
I64 = NDArray[np.int64]

GROUP = 16  # points that are pooled into one of the next level
SHRINK = 4  # points of one level per point of the next
LEVELS = 3
_BUCKET = 64  # points that farthest point sampling skips together
_BATCH = 32  # buckets whose distances are told at once
_NONE = np.int32(2**31 - 1)
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
    near = np.asarray(cKDTree(points, leafsize=_BUCKET, compact_nodes=False).indices, np.int32)
    return _farthest(points, near, count)


@njit(cache=True)
def _farthest(points: F32, near: I32, count: int) -> I64:
    """Sample as :func:`farthest_points`; ``near`` ``(P,)`` are places in an order that keeps neighbours together.

    A bucket of them is left alone where no point of its box is nearer to the newest than all of them already are to
    an older one. Rounding is monotonic, so the bound holds for the numbers computed, and the sample is the plain one's.
    """
    n = len(points)
    rows = (n + _BUCKET - 1) // _BUCKET
    buckets = (rows + _BATCH - 1) // _BATCH * _BATCH  # those beyond are empty
    low = np.full((3, buckets), np.float32(np.inf))
    high = np.full((3, buckets), np.float32(-np.inf))
    room = np.zeros((3, rows * _BUCKET), np.float32)
    x, y, z = room[0], room[1], room[2]
    place = np.full(rows * _BUCKET, _NONE)
    distance = np.full(rows * _BUCKET, np.float32(-1.0))  # behind the last point, none is far
    for i in range(n):
        x[i], y[i], z[i] = points[near[i], 0], points[near[i], 1], points[near[i], 2]
        place[i] = near[i]
        distance[i] = np.inf
        for axis in range(3):
            low[axis, i // _BUCKET] = min(low[axis, i // _BUCKET], points[near[i], axis])
            high[axis, i // _BUCKET] = max(high[axis, i // _BUCKET], points[near[i], axis])
    order = distance.view(np.int32)  # numbers of no less than 0 are ordered as their bits are
    reach = np.full(buckets, np.float32(-1.0))  # the largest distance in each bucket
    reach[:rows] = np.inf
    which = np.zeros(buckets, np.int32)  # the point that has it, of the lowest place
    far, who = reach[::_BATCH].copy(), which[::_BATCH].copy()  # the same of each batch of buckets
    away = np.empty(_BATCH, np.float32)
    chosen = np.zeros(count, np.int64)
    last = 0
    zero = np.float32(0.0)
    for k in range(1, count):
        px, py, pz = points[last, 0], points[last, 1], points[last, 2]
        for batch in range(len(far)):
            start = batch * _BATCH
            touched = False
            for i in range(_BATCH):
                dx = max(low[0, start + i] - px, px - high[0, start + i], zero)
                dy = max(low[1, start + i] - py, py - high[1, start + i], zero)
                dz = max(low[2, start + i] - pz, pz - high[2, start + i], zero)
                away[i] = dx * dx + dy * dy + dz * dz
                touched |= away[i] < reach[start + i]
            if not touched:
                continue
            for b in range(start, start + _BATCH):
                if away[b - start] >= reach[b]:
                    continue
                inside = b * _BUCKET
                for i in range(_BUCKET):
                    dx, dy, dz = x[inside + i] - px, y[inside + i] - py, z[inside + i] - pz
                    distance[inside + i] = min(distance[inside + i], dx * dx + dy * dy + dz * dz)
                most, at = np.int32(0), _NONE
                for i in range(_BUCKET):
                    most = max(most, order[inside + i])
                for i in range(_BUCKET):
                    at = min(at, place[inside + i] if order[inside + i] == most else _NONE)
                reach[b] = np.int32(most).view(np.float32)
                which[b] = at
            top = _first(reach, which, start, start + _BATCH)
            far[batch], who[batch] = reach[top], which[top]
        last = who[_first(far, who, 0, len(far))]
        chosen[k] = last
    return chosen


@njit(cache=True)
def _first(reach: F32, which: I32, start: int, end: int) -> int:
    """Return which of some buckets reaches farthest, by a point of the lowest place."""
    top = start
    for b in range(start + 1, end):
        if reach[b] > reach[top] or (reach[b] == reach[top] and which[b] < which[top]):
            top = b
    return top


def interpolate(points: F32, queries: F32) -> tuple[I64, F32]:
    """Return the three nearest of ``points`` ``(M, 3)`` to each query ``(Q, 3)`` and weights by inverse distance."""
    distance, places = three_nearest(points, queries)
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
