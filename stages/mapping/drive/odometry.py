"""Odometry: each scan is registered to the map of those before it (VGICP of small-gicp), de-skewed by what it finds.

Distributions per voxel as target, not nearest points: on the rings of a spinning sensor nearest points pull
every motion towards none, by 7 % on simulated streets.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import chain
from typing import Any

import numpy as np
import small_gicp
from numpy.typing import NDArray

from salpcc.stages.mapping.drive.deskew import deskewed, motion_of, step_of
from salpcc.stages.mapping.drive.poses import inverse, proper

F64 = NDArray[np.float64]
Cloud = Any  # small_gicp.PointCloud

THIN = 0.7  # metres, between the points that are registered
_CELL = 1.0  # metres, of the distributions of the target
_REACH = 1.0  # metres, farther pairs do not count
_ROUNDS = 30
_NEIGHBOURS = 10  # that a point's distribution is taken from
_REMEMBERED = 100  # insertions; cells not met for longer are forgotten, so memory is bounded
_FEWEST = 100  # thinned points that a registration needs
_LEAST_OVERLAP = 0.35  # share of the points that found a partner, below which a registration is void


@dataclass(frozen=True, eq=False)
class Thinned:
    """What of a scan is registered.

    Attributes:
        number: of its turn.
        points: ``(N, 3)`` float32 in the sensor's frame, as recorded.
        before: ``(N,)`` float32, turns by which each was fired before the scan's instant.
        motion: ``(6,)``, the scan's own, where it was compensated; else None.
    """

    number: int
    points: NDArray[np.float32]
    before: NDArray[np.float32]
    motion: F64 | None

    @property
    def compensated(self) -> bool:
        """Whether nothing is to be de-skewed."""
        return self.motion is not None

    def at(self, motion: F64) -> F64:
        """Return its points ``(N, 3)`` de-skewed by the motion ``(6,)`` of a trajectory."""
        if self.compensated:
            return self.points.astype(np.float64)
        return deskewed(self.points, self.before.astype(np.float64), motion)


@dataclass(frozen=True)
class Registered:
    """A pose found, and whether it can be trusted; ``overlap`` is the share of points with a partner."""

    pose: F64
    overlap: float
    good: bool


def thin(points: NDArray[np.floating], before: F64) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Thin points ``(N, 3)`` and their ``before`` ``(N,)``: the mean of each cube of :data:`THIN`."""
    if not len(points):
        return np.empty((0, 3), np.float32), np.empty(0, np.float32)
    at = np.floor(points * (1.0 / THIN)).astype(np.int64) + (1 << 20)
    key = (at[:, 0] << 42) | (at[:, 1] << 21) | at[:, 2]
    order = np.argsort(key, kind="stable")
    first = np.flatnonzero(np.concatenate([[True], np.diff(key[order]) != 0]))
    size = np.diff(np.append(first, len(order)))
    rows = np.column_stack([points, before]).astype(np.float64)[order]
    mean = np.add.reduceat(rows, first) / size[:, None]
    return mean[:, :3].astype(np.float32), mean[:, 3].astype(np.float32)


class LocalMap:
    """What was seen lately, as distributions per cell; a cloud can be registered to it."""

    def __init__(self) -> None:
        self._cells = small_gicp.GaussianVoxelMap(_CELL)
        self._cells.set_lru(horizon=_REMEMBERED, clear_cycle=10)

    def register(self, cloud: Cloud, guess: F64) -> Registered:
        """Find the pose of a cloud from a guess."""
        if cloud.size() < _FEWEST:
            return Registered(guess, 0.0, False)
        found = small_gicp.align(
            self._cells, cloud, guess, max_correspondence_distance=_REACH, max_iterations=_ROUNDS
        )
        overlap = found.num_inliers / cloud.size()
        good = bool(found.converged) and overlap >= _LEAST_OVERLAP
        return Registered(proper(np.asarray(found.T_target_source, np.float64)), overlap, good)

    def insert(self, cloud: Cloud, pose: F64) -> None:
        """Add a cloud that was placed."""
        if cloud.size() >= _FEWEST:
            self._cells.insert(cloud, pose)


def follow(clouds: Iterable[Thinned], given: F64 | None = None) -> Iterator[Registered]:
    """Register clouds one after the other; the first one's frame is that of the results.

    Each is tried from its own motion, then from the motion of the one before, then from ``given`` poses ``(n, 4, 4)``. One
    that fits from none of them is told by ``good``; it stands where given poses, else the motion before, say, and a new map
    begins there. One of too few points to be registered (a sensor that was covered) stands on the way from the one before
    it to the one after.
    """
    numbered = enumerate(clouds)
    opening: list[tuple[int, Thinned]] = []
    for turn in numbered:
        opening.append(turn)
        if sum(_fit(cloud) for _, cloud in opening) == 2:
            break
    steps = _Steps(given, _first_motion([turn for turn in opening if _fit(turn[1])], given))
    target = LocalMap()
    before: tuple[int, Thinned] | None = None
    pose, waiting = np.eye(4), list[int]()
    for at, cloud in chain(opening, numbered):
        if not _fit(cloud):
            waiting.append(cloud.number)
            continue
        if before is None:
            found = Registered(pose, 1.0, True)
            yield from (Registered(pose, 0.0, True) for _ in waiting)
        else:
            turns = max(cloud.number - before[1].number, 1)
            found = _place(cloud, pose, steps.guesses(before[0], at, cloud, turns), target, turns)
            if not found.good:
                target = LocalMap()
            steps.motion = motion_of(inverse(pose) @ found.pose, turns)
            yield from _on_the_way(pose, steps.motion, before[1].number, waiting)
        pose, waiting = found.pose, []
        target.insert(distributions(cloud.at(steps.motion)), pose)
        yield found
        before = at, cloud
    if before is not None:
        yield from _on_the_way(pose, steps.motion, before[1].number, waiting)
    else:
        yield from (Registered(pose, 0.0, False) for _ in waiting)


def _fit(cloud: Thinned) -> bool:
    """Tell whether a cloud has points enough to be registered."""
    return len(cloud.points) >= _FEWEST


def _on_the_way(pose: F64, motion: F64, number: int, numbers: Iterable[int]) -> Iterator[Registered]:
    """Yield where the turns ``numbers`` stand after the turn ``number`` at ``pose``."""
    for later in numbers:
        yield Registered(pose @ step_of(motion, later - number), 0.0, True)


class _Steps:
    """Where the next scan may be: by its own motion, the motion before, given poses."""

    def __init__(self, given: F64 | None, motion: F64) -> None:
        self.given, self.motion = given, motion

    def guesses(self, here: int, there: int, cloud: Thinned, turns: int) -> list[F64]:
        """Return steps to a cloud, ``turns`` after the one before; ``here`` and ``there``: both clouds' places among given poses."""
        own = [] if cloud.motion is None else [step_of(cloud.motion, turns)]
        said = [] if self.given is None else [inverse(self.given[here]) @ self.given[there]]
        return [*own, step_of(self.motion, turns), *said]


def _place(cloud: Thinned, before: F64, guesses: list[F64], target: LocalMap, turns: int) -> Registered:
    """Register a cloud to the map, from each guess of its step until one holds; twice where it is de-skewed by its step."""
    found = Registered(before @ guesses[-1], 0.0, False)
    for step in guesses:
        found = target.register(distributions(cloud.at(motion_of(step, turns))), before @ step)
        if found.good and not cloud.compensated:
            step = inverse(before) @ found.pose
            found = target.register(distributions(cloud.at(motion_of(step, turns))), found.pose)
        if found.good:
            return found
    return Registered(before @ guesses[-1], found.overlap, False)


def _first_motion(opening: list[tuple[int, Thinned]], given: F64 | None) -> F64:
    """Return the motion ``(6,)`` of the first of two clouds: its own, as given poses say, or by which the second fits it.

    Each is given with its place among the given poses.
    """
    if not opening:
        return np.zeros(6)
    (here, first), *others = opening
    if first.motion is not None:
        return first.motion
    if not others:
        return np.zeros(6)
    ((there, second),) = others
    turns = max(second.number - first.number, 1)
    if given is not None:
        return motion_of(inverse(given[here]) @ given[there], turns)
    target = LocalMap()
    target.insert(distributions(first.at(np.zeros(6))), np.eye(4))
    return motion_of(target.register(distributions(second.at(np.zeros(6))), np.eye(4)).pose, turns)


def distributions(points: F64) -> Cloud:
    """Return points ``(N, 3)`` with what lies around each of them, to register; an empty cloud of too few."""
    if len(points) < _FEWEST:
        return small_gicp.PointCloud(np.empty((0, 3)))
    return small_gicp.preprocess_points(points, 0.01, _NEIGHBOURS, 1)[0]
