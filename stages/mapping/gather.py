"""Gather the scans of one group into a submap: fused voxels, views to carve with, what registration needs."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from salpcc.schemas.labels import GROUP_OF_CLASS, MOVABLE
from salpcc.schemas.scan import Scan
from salpcc.stages.mapping.config import MapConfig
from salpcc.stages.mapping.odometry import Registered, follow, start_of
from salpcc.stages.mapping.poses import move
from salpcc.stages.mapping.view import View, view_of
from salpcc.stages.mapping.voxel import Voxels, fuse, fuse_scan
from salpcc.stages.segment.geometric import split_ground

F64 = NDArray[np.float64]
Clouds = list[NDArray[np.float32]]


@dataclass(frozen=True, eq=False)
class Submap:
    """A group of scans as one cloud: in the map's frame where poses were given, else in its first scan's.

    Attributes:
        voxels: all points, fused.
        views: of some scans, to carve with.
        poses: of the scans ``(n, 4, 4)``, in the frame of the submap.
        points: decoded points, of all scans.
        found: what registration found, by scan, where it was asked; in the frame of the first scan.
    """

    voxels: Voxels
    views: list[View]
    poses: F64
    points: int
    found: list[Registered]


def gather(
    scans: Iterable[Scan],
    numbers: Sequence[int],
    poses: F64 | None,
    config: MapConfig,
    register: bool = False,
) -> Submap:
    """Gather scans; with ``poses`` None, or to ``register`` anyway, each is registered to those before it.

    Args:
        scans: decoded scans; with poses given only one is held at a time.
        numbers: their frame numbers, which tell how many turns apart they are.
        poses: ``(n, 4, 4)`` sensor to map, or None.
    """
    held = list(scans) if poses is None or register else scans
    found: list[Registered] = []
    if isinstance(held, list):
        found = follow([standing(scan, config) for scan in held], _starts(held, numbers, poses))
    placed = np.array([f.pose for f in found]) if poses is None else poses
    parts: list[Voxels] = []
    views: list[View] = []
    points = 0
    for scan, pose in zip(held, placed, strict=True):
        points += len(scan)
        near = in_range(scan, config)
        # What no one labelled has ground at least, which free space does not carve.
        classes = (split_ground(scan.points) if scan.classes is None else scan.classes)[near]
        parts.append(fuse_scan(move(scan.points[near], pose), scan.intensity[near], classes, config.voxel))
        if config.carve and (not views or _way(views[-1].pose, pose) >= config.view_every):
            views.append(view_of(scan.points, scan.motion, pose))
    return Submap(fuse(Voxels.together(parts), config.voxel), views, placed, points, found)


def in_range(scan: Scan, config: MapConfig) -> NDArray[np.bool_]:
    """Mark the points ``(N,)`` that a map takes; one that is not finite is in no range."""
    square = np.square(scan.points.astype(np.float64)).sum(axis=1)
    with np.errstate(invalid="ignore"):
        return np.asarray((square >= config.min_range**2) & (square <= config.max_range**2))


def standing(scan: Scan, config: MapConfig) -> NDArray[np.float32]:
    """Return the points of a scan to register by: in range, and of nothing that its classes call movable."""
    kept = in_range(scan, config)
    if scan.classes is not None:
        kept &= GROUP_OF_CLASS[scan.classes] != MOVABLE
    return scan.points[kept]


def _starts(scans: list[Scan], numbers: Sequence[int], poses: F64 | None) -> list[F64 | None]:
    """Guess each scan's pose in the frame of the one before, by its own motion, else by the given poses."""
    starts: list[F64 | None] = [None]
    for at in range(1, len(scans)):
        start = start_of(scans[at].motion, numbers[at] - numbers[at - 1])
        if start is None and poses is not None:
            start = np.linalg.inv(poses[at - 1]) @ poses[at]
        starts.append(start)
    return starts


def _way(a: F64, b: F64) -> float:
    return float(np.linalg.norm(a[:3, 3] - b[:3, 3]))
