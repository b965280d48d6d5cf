"""Objects, not points: what hangs together is one thing, in a scan and from scan to scan, and is judged as one.

The network judges pixels, so half of a lorry is a house and nine points of a guard rail are a car. What stands on the
ground falls apart at gaps; each part of a possible size is given the mean of what is said of its pixels. Parts of
consecutive scans that lie at one place, or close by and of one size, are one object. One that left its place is the
likelier movable, in all of them. What lies within a movable one, a load or what is seen through windows, is part of
it. What is larger than any object is a house, a hedge or a guard rail (or a tram): only what stands apart from it can
be movable.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from salpcc.schemas.labels import CLASSES, GROUND, MOVABLE
from salpcc.stages.segment.network.range_image import HEIGHT, RANGE, wrapped
from salpcc.stages.segment.segmenter import Segmentation

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I32 = NDArray[np.int32]
U8 = NDArray[np.uint8]

_GAP, _GAP_BY_RANGE = 0.25, 0.005  # metres between pixels of one object, and more for every metre of range
_BESIDE = 2  # pixels to each side that may be one object's
_FLOOR = 0.05  # metres above the ground that objects begin at
_LEAST = 8  # pixels
_LEAST_SURE, _SURE = (
    50,
    0.8,
)  # pixels, and mean probability, of a movable object that touches a thing which is not
_SEAM = 0.4  # of the pixels along its left and right edge that go on into that thing: a piece of it, then
_SEAMLESS, _SEAMLESS_BY_RANGE = (
    0.03,
    0.004,
)  # metres between neighbours of one surface, and more for every metre of range
_LONGEST, _HIGHEST = 20.0, 4.5  # metres; a larger thing is not one object
_LONG, _LOW = 6.0, 1.2  # metres; what is longer and ends lower is a rail or a kerb, not a vehicle
_SPLINTER = 0.8  # metres; what is shorter seldom is a whole thing,
_SPLINTER_COUNTS = 0.5  # so its odds to be movable are halved
_HOLDS = 3.0  # metres; what is longer and movable may have windows and a load
_STAYS = 0.02  # probability to be movable of what is no part of it all the same
_SAME_PLACE = 1.5  # metres between an object and itself, a scan later
_SIZE_COUNTS = 0.5  # metres of place that a metre of size is worth
_LEFT = 2.0  # metres, and its own length, that an object has gone which left its place
_LEFT_COUNTS = (
    0.5  # added to its probability to be movable: edges of walls wander, too, but nobody doubts those
)


@dataclass(frozen=True, eq=False)
class Objects:
    """The objects of one scan.

    Attributes:
        names: ``(H, W)`` int32, the object of each pixel, -1 for none.
        weights: ``(n,)`` pixels of each.
        said: ``(n, 3)`` the sum of its pixels' probabilities by group.
        votes: ``(n, 3, classes)`` pixels by their best class of each group.
        shape: ``(n, 5)`` its mean x, y, z, its length and height, metres.
        beyond: ``(H, W)`` the pixels of what no object looks like: larger than any and not movable on the whole (as trams
            and queues are), or long and low as a rail.
    """

    names: I32
    weights: F64
    said: F64
    votes: NDArray[np.int64]
    shape: F64
    beyond: NDArray[np.bool_]


@njit(cache=True)
def _root(parent: I32, i: int) -> int:
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


@njit(cache=True, inline="always")
def _square(planes: F32, i: int, j: int, a: int, b: int) -> np.float32:
    """Square of the metres between two pixels."""
    dx = planes[0, i, j] - planes[0, a, b]
    dy = planes[1, i, j] - planes[1, a, b]
    dz = planes[2, i, j] - planes[2, a, b]
    return dx * dx + dy * dy + dz * dz


@njit(cache=True)
def connected(planes: F32, asked: NDArray[np.bool_]) -> tuple[I32, int]:
    """Name the connected parts of the ``asked`` pixels ``(H, W)``: the part of each, from 0 on, -1 for none; and how many."""
    rows, columns = asked.shape
    parent = np.arange(rows * columns).astype(np.int32)
    for i in range(rows):
        for j in range(columns):
            if not asked[i, j]:
                continue
            here = _root(parent, i * columns + j)
            gap = _GAP + _GAP_BY_RANGE * planes[RANGE, i, j]
            for a in range(i, min(i + _BESIDE, rows - 1) + 1):
                for step in range(1 if a == i else -_BESIDE, _BESIDE + 1):
                    b = wrapped(j + step, columns)
                    if not asked[a, b] or parent[a * columns + b] == here:  # most are one part already
                        continue
                    if _square(planes, i, j, a, b) < gap * gap:
                        there = _root(parent, a * columns + b)
                        if there < here:
                            parent[here] = there
                            here = there
                        elif here < there:
                            parent[there] = here
    names = np.full((rows, columns), -1, np.int32)
    count = 0
    for i in range(rows):
        for j in range(columns):
            if not asked[i, j]:
                continue
            root = _root(parent, i * columns + j)  # the part's first pixel
            if root == i * columns + j:
                names[i, j] = count
                count += 1
            else:
                names[i, j] = names[root // columns, root % columns]
    return names, count


@njit(cache=True)
def _sums(
    names: I32, count: int, planes: F32, groups: F32, best: NDArray[np.uint8], classes: int
) -> tuple[F64, F64, NDArray[np.int64], F64, F64, F64]:
    """Per part: pixels, sums of probabilities, votes, sums of places, and the corners of its box."""
    weights = np.zeros(count)
    said = np.zeros((count, len(groups)))
    votes = np.zeros((count, len(groups), classes), np.int64)
    places = np.zeros((count, 3))
    low = np.full((count, 4), np.inf)  # x, y, z, height
    high = np.full((count, 4), -np.inf)
    for i in range(names.shape[0]):
        for j in range(names.shape[1]):
            k = names[i, j]
            if k < 0:
                continue
            weights[k] += 1
            for group in range(len(groups)):
                said[k, group] += groups[group, i, j]
                votes[k, group, best[group, i, j]] += 1
            for axis in range(3):
                places[k, axis] += planes[axis, i, j]
            for axis in range(4):
                value = planes[axis if axis < 3 else HEIGHT, i, j]
                low[k, axis] = min(low[k, axis], value)
                high[k, axis] = max(high[k, axis], value)
    return weights, said, votes, places, low, high


def objects_of(one: Segmentation) -> Objects:
    """Take apart what stands on the ground of a scan; what is too small or too large to be an object is none."""
    planes = np.ascontiguousarray(one.image.planes)
    asked = (one.image.index >= 0) & (one.groups[GROUND] < 0.5) & (planes[HEIGHT] > _FLOOR)
    names, count = connected(planes, asked)
    names, count = _apart(names, count, planes, one.groups[MOVABLE])
    weights, said, votes, places, low, high = _sums(
        names, count, planes, np.ascontiguousarray(one.groups), one.best, len(CLASSES)
    )
    size = high - low
    length = np.hypot(size[:, 0], size[:, 1])
    large = (length >= _LONGEST) | (high[:, 3] >= _HIGHEST)
    fits = (weights >= _LEAST) & ~large
    beyond = names >= 0
    house = large & (said[:, MOVABLE] < 0.5 * weights)
    rail = (length > _LONG) & (high[:, 3] < _LOW)
    beyond[beyond] = (house | rail)[names[beyond]]
    number = np.where(fits, np.cumsum(fits) - 1, -1).astype(np.int32)
    names = np.where(names >= 0, number[names], np.int32(-1)) if count else names
    shape = np.column_stack([places / np.maximum(weights, 1)[:, None], length, size[:, 2]])
    return Objects(names, weights[fits], said[fits], votes[fits], shape[fits], beyond)


def _apart(names: I32, count: int, planes: F32, movable: F32) -> tuple[I32, int]:
    """Set apart from a part ``(H, W)`` that is not movable on the whole what in it surely is: people in front of a wall.

    What goes on into the rest without a seam is a piece of the wall itself.
    """
    within = names >= 0
    weights = np.bincount(names[within], minlength=count)
    whole = np.bincount(names[within], movable[within], count) < 0.5 * weights
    likely = within & (movable > 0.5)
    likely[within] &= whole[names[within]]
    cores, n = connected(planes, likely)
    inside = cores >= 0
    size = np.bincount(cores[inside], minlength=n)
    sure = (size >= _LEAST_SURE) & (np.bincount(cores[inside], movable[inside], n) >= _SURE * size)
    ends, seamless = _edges(names, cores, n, planes)
    sure &= seamless <= _SEAM * ends
    inside[inside] = sure[cores[inside]]
    names = names.copy()
    names[inside] = count + cores[inside]
    return names, count + n


@njit(cache=True)
def _edges(names: I32, cores: I32, count: int, planes: F32) -> tuple[F64, F64]:
    """Per core ``(count,)``: pixels at its left and right edge, and those of them that the part goes on beside, on one surface."""
    ends, seamless = np.zeros(count), np.zeros(count)
    rows, columns = names.shape
    for i in range(rows):
        for j in range(columns):
            core = cores[i, j]
            if core < 0:
                continue
            gap = _SEAMLESS + _SEAMLESS_BY_RANGE * planes[RANGE, i, j]
            for beside in (wrapped(j - 1, columns), wrapped(j + 1, columns)):
                if cores[i, beside] == core:
                    continue
                ends[core] += 1
                if names[i, beside] != names[i, j]:
                    continue
                seamless[core] += _square(planes, i, j, i, beside) < gap * gap
    return ends, seamless


def follow(before: Objects, after: Objects, pose: F64) -> list[tuple[int, int]]:
    """Pair the objects of a scan with those of the next that are each other's nearest in place and size.

    ``pose`` ``(4, 4)`` carries the first scan into the second one's frame.
    """
    if not len(before.shape) or not len(after.shape):
        return []
    ones, others = before.shape.copy(), after.shape.copy()
    ones[:, :3] = ones[:, :3] @ pose[:3, :3].T + pose[:3, 3]
    ones[:, 3:] *= _SIZE_COUNTS
    others[:, 3:] *= _SIZE_COUNTS
    off, there = map(np.asarray, cKDTree(others).query(ones, distance_upper_bound=_SAME_PLACE))
    back = np.asarray(cKDTree(ones).query(others, distance_upper_bound=_SAME_PLACE)[1])
    return [
        (one, int(there[one])) for one in np.flatnonzero(np.isfinite(off)).tolist() if back[there[one]] == one
    ]


def judge_objects(found: Sequence[Segmentation], steps: Sequence[F64 | None]) -> list[Segmentation]:
    """Give every pixel of an object the object's mean probabilities, over the scans of a group, and its classes.

    Args:
        found: what is said of each scan, in order of time.
        steps: per scan the ``(4, 4)`` that carries the scan before into its frame; None where nothing is followed.
    """
    seen = [objects_of(one) for one in found]
    starts = np.cumsum([0, *(len(one.weights) for one in seen)])
    parent = np.arange(starts[-1]).astype(np.int32)
    for k in range(1, len(seen)):
        step = steps[k]
        for earlier, later in [] if step is None else follow(seen[k - 1], seen[k], step):
            parent[starts[k] + later] = _root(parent, int(starts[k - 1]) + earlier)
    whole = np.array([_root(parent, i) for i in range(len(parent))], np.int64)
    weights = np.bincount(whole, np.concatenate([one.weights for one in seen]), len(whole))
    said = np.zeros((len(whole), seen[0].said.shape[1]))
    votes = np.zeros((len(whole), *seen[0].votes.shape[1:]), np.int64)
    np.add.at(said, whole, np.concatenate([one.said for one in seen]))
    np.add.at(votes, whole, np.concatenate([one.votes for one in seen]))
    said /= np.maximum(weights, 1)[:, None]
    said[_left(seen, steps, whole), MOVABLE] += _LEFT_COUNTS
    length = np.bincount(whole, np.concatenate([one.weights * one.shape[:, 3] for one in seen]), len(whole))
    said[length < _SPLINTER * weights, MOVABLE] *= _SPLINTER_COUNTS
    mean = said.astype(np.float32)[whole]
    best = votes.argmax(axis=2).astype(np.uint8)[whole]
    judged = []
    for one, things, start, end in zip(found, seen, starts, starts[1:], strict=False):
        whose = start + _holders(one, things, mean[start:end])
        groups, classes = one.groups.copy(), one.best.copy()
        _hand_out(things.names, things.beyond, mean[whose], best[whose], groups, classes)
        judged.append(replace(one, groups=groups, best=classes))
    return judged


@njit(cache=True)
def _hand_out(names: I32, beyond: NDArray[np.bool_], mean: F32, best: U8, groups: F32, classes: U8) -> None:
    """Give the pixels ``(3, H, W)`` of each object its ``mean`` probabilities and its ``best`` classes, both ``(n, 3)``."""
    count, rows, columns = groups.shape
    for i in range(rows):
        for j in range(columns):
            k = names[i, j]
            if k >= 0:
                for group in range(count):
                    groups[group, i, j] = mean[k, group]
                    classes[group, i, j] = best[k, group]
            if beyond[i, j]:
                groups[MOVABLE, i, j] = 0.0


def _holders(one: Segmentation, things: Objects, mean: F32) -> I32:
    """Name for each object ``(n,)`` of ``mean`` probabilities ``(n, 3)`` the movable one that it lies within; else itself.

    Within is what has pixels of the other all around, in no half of the plane none.
    """
    holders = np.arange(len(mean)).astype(np.int32)
    movable = mean.argmax(axis=1) == MOVABLE
    middle, length, height = things.shape[:, :3], things.shape[:, 3], things.shape[:, 4]
    for k in np.flatnonzero(movable & (length > _HOLDS)).tolist():
        off = middle - middle[k]
        near = (np.hypot(off[:, 0], off[:, 1]) < length[k]) & (np.abs(off[:, 2]) < height[k])
        near &= ~movable & (length < length[k]) & (mean[:, MOVABLE] > _STAYS)
        x, y = one.image.planes[:2, things.names == k].astype(np.float64)
        for part in np.flatnonzero(near).tolist():
            angles = np.sort(np.arctan2(y - middle[part, 1], x - middle[part, 0]))
            if np.diff(angles, append=angles[0] + 2 * np.pi).max() < np.pi:
                holders[part] = k
    return holders


def _left(
    seen: Sequence[Objects], steps: Sequence[F64 | None], whole: NDArray[np.int64]
) -> NDArray[np.bool_]:
    """Tell of each object ``(n,)``, all scans' numbered through, whether it left its place; ``whole`` names its first part."""
    places = []
    pose = np.eye(4)  # into the frame of the first scan that all since are followed from
    for one, step in zip(seen, steps, strict=True):
        pose = np.eye(4) if step is None else pose @ np.linalg.inv(step)
        places.append((one.shape[:, :3] @ pose[:3, :3].T + pose[:3, 3])[:, :2])
    place = np.concatenate(places)
    last = np.arange(len(whole))
    np.maximum.at(last, whole, np.arange(len(whole)))
    way = np.linalg.norm(place[last] - place, axis=1)
    length = np.concatenate([one.shape[:, 3] for one in seen])
    return (whole == np.arange(len(whole))) & (way > np.maximum(_LEFT, length))
