"""Several scans of a group: what the scans before and after say of the same place.

A surface that the neighbours saw too is judged by all who saw it. A place that a neighbour looked
through held nothing when it looked: what stands there now has moved (free space, as Removert and DUFOMap
use it). Where scans lie is found by registering each to the one before (:mod:`.registration`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.schemas.labels import GROUND, MOVABLE, OTHER
from salpcc.stages.lattice.sensor_model import load_sensor
from salpcc.stages.segment.network.range_image import HEIGHT, nearest_cone
from salpcc.stages.segment.segmenter import Segmentation

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

REACH = 4  # scans to either side that are asked
_SAME = 0.25  # metres between two views of one surface, plus 1 % of the range
_THROUGH = 1.0  # metres that a neighbour must see past a place, plus 5 % of the range
_SURE_GROUND, _SURE_OTHER = 0.95, 0.98  # what is so probable asks no neighbour: three quarters of the pixels
_ABOVE = 0.3  # metres above the ground; free space says nothing of the ground itself
_NEIGHBOUR_WEIGHT = 0.5  # of a neighbour's word; the scan's own counts 1
_LOOKS = 3  # neighbours that must have seen through a place
_THROUGH_WEIGHT = (
    0.25  # added to the probability that a pixel is movable where enough neighbours saw through it
)


def pose_between(steps: Sequence[F64 | None], start: int, end: int) -> F64 | None:
    """Chain steps, each of which carries the scan before into one's frame: the ``(4, 4)`` that carries scan ``start`` into scan ``end``."""
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
    points: F64,
    pose: F64,
    tangent: F64,
    z0: F64,
    places: F32,
    groups: F32,
    weight: float,
    total: F32,
    through: NDArray[np.uint8],
) -> None:
    """Add a neighbour's word on each point ``(N, 3)`` to ``total`` ``(N, G + 1)``, its last column being the weight,
    and note whether it saw through the point's place.

    ``pose`` carries points into the neighbour's frame; it has ``places`` ``(H, W, 4)`` and ``groups`` ``(H, W, G)``.
    """
    rows, columns, count = groups.shape
    row = 0
    for i in range(len(points)):
        p, q, r = points[i, 0], points[i, 1], points[i, 2]
        x = np.float32(pose[0, 0] * p + pose[0, 1] * q + pose[0, 2] * r + pose[0, 3])
        y = np.float32(pose[1, 0] * p + pose[1, 1] * q + pose[1, 2] * r + pose[1, 3])
        z = np.float32(pose[2, 0] * p + pose[2, 1] * q + pose[2, 2] * r + pose[2, 3])
        row = nearest_cone(x, y, z, tangent, z0, row)
        if row < 0:
            continue
        distance = np.sqrt(x * x + y * y + z * z)
        centre = min(int(0.5 * (1.0 - np.arctan2(y, x) / np.pi) * columns), columns - 1)
        left = centre - 1 if centre > 0 else columns - 1
        right = centre + 1 if centre < columns - 1 else 0
        # No branches but on the whole: what is seen around a point follows no pattern.
        nearest = shortest = np.float32(np.inf)
        at_row, at_column = row, centre
        seen = 0
        for a in range(max(row - 1, 0), min(row + 1, rows - 1) + 1):
            for b in (left, centre, right):
                dx, dy, dz = places[a, b, 0] - x, places[a, b, 1] - y, places[a, b, 2] - z
                off = dx * dx + dy * dy + dz * dz
                closer = off < nearest
                nearest = off if closer else nearest
                at_row = a if closer else at_row
                at_column = b if closer else at_column
                shortest = min(shortest, places[a, b, 3])
                seen += places[a, b, 3] < np.inf
        if nearest < (_SAME + 0.01 * distance) ** 2:
            for group in range(count):
                total[i, group] += weight * groups[at_row, at_column, group]
            total[i, count] += weight
        elif seen >= 5 and shortest >= distance + _THROUGH + 0.05 * distance:
            through[i] += 1


def agree(
    found: Sequence[Segmentation], steps: Sequence[F64 | None], free_space: bool = True
) -> list[Segmentation]:
    """Let the scans of a group settle what each pixel is.

    Args:
        found: what the network says of each scan, in order of time.
        steps: per scan the ``(4, 4)`` that carries the scan before into its frame, or None where it is not known
            (nothing is asked across it).
        free_space: whether what neighbours looked through counts.
    """
    sensor = load_sensor("hdl64e")
    tangent = np.tan(sensor.theta)
    places = [one.image.places for one in found]
    said = [np.ascontiguousarray(one.groups.transpose(1, 2, 0)) for one in found]
    settled = []
    for here, own in enumerate(found):
        sure = (own.groups[GROUND] > _SURE_GROUND) | (own.groups[OTHER] > _SURE_OTHER)
        seen = (own.image.index >= 0) & ~sure
        points = places[here][seen][:, :3].astype(np.float64)
        total = np.ones((len(points), len(own.groups) + 1), np.float32)
        total[:, :-1] = said[here][seen]
        through = np.zeros(len(points), np.uint8)
        for there in range(max(here - REACH, 0), min(here + REACH, len(found) - 1) + 1):
            pose = pose_between(steps, here, there)
            if there == here or pose is None:
                continue
            theirs = places[there], said[there]
            _ask(points, pose, tangent, sensor.z0, *theirs, _NEIGHBOUR_WEIGHT, total, through)
        groups = own.groups.copy()
        groups[:, seen] = (total[:, :-1] / total[:, -1:]).T
        if free_space:
            gone = np.zeros(seen.shape, np.bool_)
            gone[seen] = (through >= _LOOKS) & (own.image.planes[HEIGHT, seen] > _ABOVE)
            groups[MOVABLE, gone] += _THROUGH_WEIGHT
        settled.append(replace(own, groups=groups))
    return settled
