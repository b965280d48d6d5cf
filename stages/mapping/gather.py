"""Gather the scans of one group into a submap: fused voxels, and views to carve with."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from salpcc.schemas.labels import CLASSES, GROUP_OF_CLASS, MOVABLE
from salpcc.schemas.scan import Scan
from salpcc.stages.mapping.config import MapConfig
from salpcc.stages.mapping.drive.deskew import deskewed, turns_before
from salpcc.stages.mapping.drive.poses import move
from salpcc.stages.mapping.view import View, view_of
from salpcc.stages.mapping.voxel import Voxels, fuse, fuse_scan
from salpcc.stages.segment.geometric import split_ground

F64 = NDArray[np.float64]

# What is in a movable layer, of whatever class.
_MAY_MOVE = next(k for k, c in enumerate(CLASSES) if c.name == "other-vehicle")


@dataclass(frozen=True, eq=False)
class Submap:
    """A group of scans as one cloud, in the map's frame.

    Attributes:
        voxels: all points, fused.
        views: of some scans, to carve with.
        points: decoded points, of all scans.
    """

    voxels: Voxels
    views: list[View]
    points: int


def gather(scans: Iterable[Scan], poses: F64, motions: F64, config: MapConfig) -> Submap:
    """Gather scans, of which one is held at a time.

    Args:
        poses: ``(n, 4, 4)`` sensor to map.
        motions: ``(n, 6)`` by which each is de-skewed; zeros for a compensated one.
    """
    parts: list[Voxels] = []
    views: list[View] = []
    points = 0
    for scan, pose, motion in zip(scans, poses, motions, strict=True):
        points += len(scan)
        near = in_range(scan.points, config)
        classes = _classes(scan)[near]
        seen = still(scan, motion)
        parts.append(fuse_scan(move(seen[near], pose), scan.intensity[near], classes, config.voxel))
        if config.carve and (not views or _way(views[-1].pose, pose) >= config.view_every):
            moved = motion if scan.motion is None else scan.motion
            views.append(view_of(seen.astype(np.float32), moved, pose))
    return Submap(fuse(Voxels.together(parts), config.voxel), views, points)


def _classes(scan: Scan) -> NDArray[np.uint8]:
    """Return what each point is. Where no one labelled, there is ground at least, which free space does not carve, and what may move."""
    if scan.classes is not None:
        return scan.classes
    ground = split_ground(scan.points)
    return ground if scan.movable is None else np.where(scan.movable, _MAY_MOVE, ground).astype(np.uint8)


def still(scan: Scan, motion: F64) -> F64:
    """Return the points ``(N, 3)`` of a scan as seen at the instant of its pose; ``motion`` is zero for a compensated one."""
    if not motion.any():
        return scan.points.astype(np.float64)
    return deskewed(scan.points, turns_before(scan), motion)


def in_range(points: NDArray[np.float32], config: MapConfig) -> NDArray[np.bool_]:
    """Mark the points ``(N, 3)`` that a map takes; one that is not finite is in no range."""
    square = np.square(points.astype(np.float64)).sum(axis=1)
    with np.errstate(invalid="ignore"):
        return np.asarray((square >= config.min_range**2) & (square <= config.max_range**2))


def movable_of(scan: Scan) -> NDArray[np.bool_] | None:
    """Mark the points ``(N,)`` of a scan that may move, None where nothing tells."""
    if scan.movable is not None:
        return scan.movable
    return None if scan.classes is None else np.asarray(GROUP_OF_CLASS[scan.classes] == MOVABLE)


def standing(scan: Scan, config: MapConfig) -> NDArray[np.bool_]:
    """Mark the points ``(N,)`` of a scan to register by: in range, and of nothing that its classes call movable."""
    kept = in_range(scan.points, config)
    if scan.classes is not None:
        kept &= GROUP_OF_CLASS[scan.classes] != MOVABLE
    if scan.movable is not None:
        kept &= ~scan.movable
    return kept


def _way(a: F64, b: F64) -> float:
    return float(np.linalg.norm(a[:3, 3] - b[:3, 3]))
