"""Several scans of a group: what the scans before and after say of the same place.

A surface that the neighbours saw too is judged by all who saw it. A place that a neighbour looked
through held nothing when it looked: what stands there now has moved (free space, as Removert and DUFOMap
use it). Where scans lie comes from their own motion: the motion that a scan was compensated by carries
the scan before into its frame, to some centimetres (measured against the poses of SemanticKITTI).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from salpcc.schemas.labels import MOVABLE
from salpcc.stages.lattice.sensor_model import load_sensor
from salpcc.stages.segment.range_image import HEIGHT, RANGE, nearest_cones
from salpcc.stages.segment.segmenter import Segmentation

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

REACH = 4  # scans to either side that are asked
_SAME = 0.25  # metres between two views of one surface, plus 1 % of the range
_THROUGH = 1.0  # metres that a neighbour must see past a place, plus 5 % of the range
_ABOVE = 0.3  # metres above the ground; free space says nothing of the ground itself
_NEIGHBOUR_WEIGHT = 0.5  # of a neighbour's word; the scan's own counts 1
_LOOKS = 3  # neighbours that must have seen through a place
_THROUGH_WEIGHT = (
    0.25  # added to the probability that a pixel is movable where enough neighbours saw through it
)


def relative_poses(motions: Sequence[F64 | None]) -> list[F64 | None]:
    """Return per scan the ``(4, 4)`` that carries the scan before it into its frame, None where unknown."""
    poses: list[F64 | None] = []
    for motion in motions:
        if motion is None:
            poses.append(None)
            continue
        pose = np.eye(4)
        pose[:3, :3] = Rotation.from_rotvec(motion[3:]).as_matrix()
        pose[:3, 3] = motion[:3]
        poses.append(pose)
    return poses


def pose_between(steps: Sequence[F64 | None], start: int, end: int) -> F64 | None:
    """Chain the steps of :func:`relative_poses`: the ``(4, 4)`` that carries scan ``start`` into scan ``end``."""
    if end < start:
        back = pose_between(steps, end, start)
        return None if back is None else np.linalg.inv(back).astype(np.float64)
    pose = np.eye(4)
    for step in steps[start + 1 : end + 1]:
        if step is None:
            return None
        pose = step @ pose
    return pose


@njit(cache=True)
def _ask(
    moved: F32,
    row: NDArray[np.int32],
    planes: F32,
    groups: F32,
    weight: float,
    total: F32,
    through: NDArray[np.uint8],
) -> None:
    """Add a neighbour's word on each point to ``total`` ``(G + 1, N)``, its last row being the weight, and note
    whether it saw through the point's place."""
    _, rows, columns = planes.shape
    for i in range(len(moved)):
        if row[i] < 0:
            continue
        x, y, z = moved[i]
        distance = np.sqrt(x * x + y * y + z * z)
        centre = min(int(0.5 * (1.0 - np.arctan2(y, x) / np.pi) * columns), columns - 1)
        nearest = np.float32(np.inf)
        at_row, at_column = -1, -1
        farther = True
        seen = 0
        for a in range(max(row[i] - 1, 0), min(row[i] + 1, rows - 1) + 1):
            for step in range(-1, 2):
                b = (centre + step) % columns
                r = planes[RANGE, a, b]
                if r <= 0:
                    continue
                seen += 1
                if r < distance + _THROUGH + 0.05 * distance:
                    farther = False
                dx, dy, dz = planes[0, a, b] - x, planes[1, a, b] - y, planes[2, a, b] - z
                off = dx * dx + dy * dy + dz * dz
                if off < nearest:
                    nearest = off
                    at_row, at_column = a, b
        if at_row >= 0 and nearest < (_SAME + 0.01 * distance) ** 2:
            for group in range(len(groups)):
                total[group, i] += weight * groups[group, at_row, at_column]
            total[len(groups), i] += weight
        elif seen >= 5 and farther:
            through[i] += 1


def agree(
    found: Sequence[Segmentation], motions: Sequence[F64 | None], free_space: bool = True
) -> list[Segmentation]:
    """Let the scans of a group settle what each pixel is.

    Args:
        found: what the network says of each scan, in order of time.
        motions: ``(6,)`` of each scan, or None where it is not known (nothing is asked across it).
        free_space: whether what neighbours looked through counts.
    """
    sensor = load_sensor("hdl64e")
    tangent = np.tan(sensor.theta)
    steps = relative_poses(motions)
    settled = []
    for here, own in enumerate(found):
        seen = own.image.index >= 0
        points = own.image.planes[:3, seen].T.astype(np.float64)
        total = np.concatenate([own.groups[:, seen], np.ones((1, len(points)), np.float32)])
        through = np.zeros(len(points), np.uint8)
        for there in range(max(here - REACH, 0), min(here + REACH, len(found) - 1) + 1):
            pose = pose_between(steps, here, there)
            if there == here or pose is None:
                continue
            moved = (points @ pose[:3, :3].T + pose[:3, 3]).astype(np.float32)
            row = nearest_cones(moved, tangent, sensor.z0)
            other = found[there]
            _ask(moved, row, other.image.planes, other.groups, _NEIGHBOUR_WEIGHT, total, through)
        groups = own.groups.copy()
        groups[:, seen] = total[:-1] / total[-1]
        if free_space:
            gone = np.zeros(seen.shape, np.bool_)
            gone[seen] = (through >= _LOOKS) & (own.image.planes[HEIGHT, seen] > _ABOVE)
            groups[MOVABLE, gone] += _THROUGH_WEIGHT
        settled.append(replace(own, groups=groups))
    return settled
