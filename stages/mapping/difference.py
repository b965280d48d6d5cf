"""What differs between two maps of one place: gone, appeared, moved, and what only one of the sessions saw.

An entry of one map that has none of the other near it has changed only if the other session looked through its place:
from where its sensor stood, the first surface of its map in that direction lies beyond. Else nobody knows.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import small_gicp
from numba import njit
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from salpcc.stages.mapping.carve import REACH, evidence
from salpcc.stages.mapping.clusters import objects_of
from salpcc.stages.mapping.drive.poses import move
from salpcc.stages.mapping.drive.registration import rotation_error
from salpcc.stages.mapping.view import COLUMNS, PITCH, ROWS, View, pixel_of
from salpcc.stages.mapping.voxel import Voxels

F64 = NDArray[np.float64]

NEAR = 0.3  # metres, or two voxels: what has anything of the other map so near is the same
_FEWEST_VIEWS, _PER_MEETING = 2, 2.0  # that must look through a place, and how many per view that ends there
_COLUMN = 1.0  # metres
_STEP = 3.0  # metres between the places that one looks from
_FEWEST = 15  # voxels of an object that is told
_FARTHEST = 20.0  # metres that an object is moved by
_ALIKE, _SLACK = 0.3, 0.1  # shares and metres by which the shape of a moved object differs
_STRIDE, _PAIRS, _LEAST, _BETTER = (
    0.5,
    2.0,
    0.35,
    0.9,
)  # of the alignment: metres, metres, share of points, of residual

SAME, UNSEEN, CHANGED = 0, 1, 2  # what became of an entry


@dataclass(frozen=True, eq=False)
class Session:
    """A map and where its scans stood, in the frame that both sessions have.

    Attributes:
        voxels: its entries.
        poses: ``(n, 4, 4)``.
        voxel: size of its voxels, metres.
    """

    voxels: Voxels
    poses: F64
    voxel: float

    def moved(self, pose: F64) -> Session:
        """Return it moved by a pose."""
        return Session(replace(self.voxels, xyz=move(self.voxels.xyz, pose)), pose @ self.poses, self.voxel)


@dataclass(frozen=True, eq=False)
class Moved:
    """An object that stands elsewhere: its number among what is gone, among what appeared, and the way between, metres."""

    gone: int
    appeared: int
    way: float


def align(a: Session, b: Session) -> tuple[F64, float]:
    """Return the pose ``(4, 4)`` that takes ``b`` onto ``a``, and the median distance then, metres, of ``b`` to what lies near in ``a``.

    It is none where registration finds none, or hardly a better one.
    """
    tree = cKDTree(a.voxels.xyz)
    stay = np.eye(4)
    found = small_gicp.align(
        a.voxels.xyz,
        b.voxels.xyz,
        downsampling_resolution=_STRIDE,
        max_correspondence_distance=_PAIRS,
        num_threads=1,
    )
    pose = np.asarray(found.T_target_source, np.float64)
    as_they_are, moved = _apart(tree, b.voxels.xyz), _apart(tree, move(b.voxels.xyz, pose))
    trusted = found.converged and moved < _BETTER * as_they_are
    return (pose, moved) if trusted else (stay, as_they_are)


def _apart(tree: cKDTree, xyz: F64) -> float:
    few = xyz[:: max(1, len(xyz) // 50_000)]
    distance = np.asarray(tree.query(few, distance_upper_bound=_PAIRS)[0])
    near = np.isfinite(distance)
    return float(np.median(distance[near])) if near.mean() > _LEAST / 10 else float("inf")


def changes(session: Session, other: Session) -> NDArray[np.uint8]:
    """Tell what became of each entry ``(M,)`` of a session in the other: SAME, UNSEEN or CHANGED."""
    xyz = session.voxels.xyz
    near = max(NEAR, 2 * max(session.voxel, other.voxel))
    distance = cKDTree(other.voxels.xyz).query(xyz, distance_upper_bound=near)[0]
    out = np.where(np.isfinite(distance), SAME, UNSEEN).astype(np.uint8)
    alone = (out == UNSEEN) & _stands(xyz, other.voxels.xyz)
    through, met = evidence(xyz[alone], _views(other, xyz[alone]))
    out[alone] = np.where((through >= _FEWEST_VIEWS) & (through >= _PER_MEETING * met), CHANGED, UNSEEN)
    return out


def _stands(xyz: F64, other: F64) -> NDArray[np.bool_]:
    """Mark the places ``(M, 3)`` that are above the lowest that either map has in their column; what is not is ground, which is grazed."""
    both = np.concatenate([xyz, other])
    at = np.floor(both[:, :2] / _COLUMN).astype(np.int64)
    _, column = np.unique(at[:, 0] * (1 << 32) + at[:, 1], return_inverse=True)
    lowest = np.full(column.max(initial=0) + 1, np.inf)
    np.minimum.at(lowest, column, both[:, 2])
    return np.asarray(xyz[:, 2] > lowest[column[: len(xyz)]] + NEAR)


def objects_among(voxels: Voxels, changed: NDArray[np.bool_]) -> NDArray[np.uint32]:
    """Number the objects of what changed, ``(M,)`` from 1, the largest first; 0 for what is none, or too small to be told."""
    out = np.zeros(len(voxels), np.uint32)
    numbers = objects_of(voxels.xyz[changed])
    numbers[np.bincount(numbers, minlength=1)[numbers] < _FEWEST] = 0
    out[changed] = numbers
    return out


def moved_objects(gone: list[Voxels], appeared: list[Voxels]) -> list[Moved]:
    """Pair objects that are gone with ones of their shape and class that appeared nearby, the nearest first; places are from 0."""
    shapes = [[_Shape.of(voxels) for voxels in side] for side in (gone, appeared)]
    pairs = sorted(
        (float(np.linalg.norm(a.middle - b.middle)), i, j)
        for i, a in enumerate(shapes[0])
        for j, b in enumerate(shapes[1])
        if a.like(b)
    )
    out, taken = [], (set[int](), set[int]())
    for way, i, j in pairs:
        if way <= _FARTHEST and i not in taken[0] and j not in taken[1]:
            out.append(Moved(i, j, way))
            taken[0].add(i)
            taken[1].add(j)
    return out


@dataclass(frozen=True, eq=False)
class _Shape:
    """What tells an object from others, however it stands: how far it spreads along its axes, its class, its size."""

    middle: F64
    spread: F64
    kind: int
    size: int

    @classmethod
    def of(cls, voxels: Voxels) -> _Shape:
        middle = voxels.xyz.mean(axis=0)
        spread = np.linalg.svd((voxels.xyz - middle) / np.sqrt(len(voxels)), compute_uv=False)
        return cls(middle, spread, voxels.kind, len(voxels))

    def like(self, other: _Shape) -> bool:
        room = np.maximum(_SLACK, _ALIKE * np.maximum(self.spread, other.spread))
        return (
            self.kind == other.kind
            and max(self.size, other.size) <= 2 * min(self.size, other.size)
            and bool((np.abs(self.spread - other.spread) <= room).all())
        )


def turned(pose: F64) -> float:
    """Return by how many degrees a pose ``(4, 4)`` turns."""
    return rotation_error(pose, np.eye(4))


def _views(session: Session, wanted: F64) -> list[View]:
    """Look from places of the drive, a few metres apart, that are near anything ``wanted`` ``(K, 3)``."""
    views: list[View] = []
    if not len(wanted):
        return views
    tree, whole = cKDTree(wanted), cKDTree(session.voxels.xyz)
    at = np.full(3, np.inf)
    for pose in session.poses:
        if np.linalg.norm(pose[:3, 3] - at) < _STEP or tree.query(pose[:3, 3])[0] > REACH:
            continue
        at = pose[:3, 3]
        seen = session.voxels.xyz[whole.query_ball_point(at, 2 * REACH)]
        views.append(View(pose, np.zeros(3), _render((seen - at) @ pose[:3, :3], session.voxel)))
    return views


@njit(cache=True)
def _render(points: F64, size: float) -> NDArray[np.uint16]:
    """Return how far, in centimetres, a map of voxels of ``size`` is free in each direction ``(ROWS, COLUMNS)``; 0 where that is not known."""
    nearest = np.zeros((ROWS, COLUMNS), np.uint16)
    pitch, step = PITCH, 2.0 * np.pi / COLUMNS
    for i in range(len(points)):
        row, column, reach = pixel_of(points[i, 0], points[i, 1], points[i, 2], np.zeros(3))
        if row < 0 or row >= ROWS or reach < 0.5:
            continue
        far = np.uint16(min(65535.0, 100.0 * reach))
        wide = size / reach  # a voxel covers what it would if it were a ball
        flat = max(0.1, np.sqrt(points[i, 0] ** 2 + points[i, 1] ** 2) / reach)
        high, broad = min(20, int(wide / pitch)), min(60, int(wide / flat / step))
        for r in range(max(0, row - high), min(ROWS, row + high + 1)):
            for c in range(column - broad, column + broad + 1):
                if nearest[r, c % COLUMNS] == 0 or far < nearest[r, c % COLUMNS]:
                    nearest[r, c % COLUMNS] = far
    clear = np.zeros((ROWS, COLUMNS), np.uint16)
    for row in range(1, ROWS - 1):
        for column in range(COLUMNS):
            clear[row, column] = nearest[row, column]
            for r in range(row - 1, row + 2):
                for c in range(column - 1, column + 2):
                    clear[row, column] = min(clear[row, column], nearest[r, c % COLUMNS])
    return clear
