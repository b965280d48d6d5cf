"""Carve: find what several scans contradict, having seen through the place where it is said to be.

A voxel that few scans met and several looked through held something that moved. What was met as often as it was looked
through stays: leaves, fences, racks, edges. It counts as met also where a view ends there, to within the error of range and
pose. Ground is grazed, not looked through, and is never carved; what is called ground but stands above it is no ground.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.schemas.labels import GROUND, GROUP_OF_CLASS
from salpcc.stages.mapping.config import Carving
from salpcc.stages.mapping.view import ROWS, View, pixel_of
from salpcc.stages.mapping.voxel import Voxels

F64 = NDArray[np.float64]

REACH = 40.0  # metres; beyond, the beams are too far apart to see through a place
_SHARE = 0.5  # views that must contradict, per scan that met the voxel
_MARGIN_PER_METRE = 0.01  # metres by which a view must have seen farther beyond
AS_EVER = Carving.model_validate({})
_CELL = 0.5  # metres, of the columns in which ground is sought
_STEP = 0.2  # metres above the lowest ground of a column, beyond which nothing is ground

_IS_GROUND = np.zeros(256, np.bool_)
_IS_GROUND[: len(GROUP_OF_CLASS)] = GROUP_OF_CLASS == GROUND


def contradicted(
    voxels: Voxels, through: NDArray[np.int32], met: NDArray[np.int32], how: Carving = AS_EVER
) -> NDArray[np.bool_]:
    """Mark the entries ``(M,)`` that enough views looked through, by :func:`evidence`."""
    needed = np.maximum(how.views, np.ceil(_SHARE * voxels.scans))
    return np.asarray((through >= needed) & (through >= how.per_meeting * met) & ~lies_on_ground(voxels))


def evidence(
    xyz: F64, views: list[View], how: Carving = AS_EVER
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Count the views that looked through each place ``(M, 3)``, and those that ended there ``(M,)``."""
    if not views or not len(xyz):
        return np.zeros(len(xyz), np.int32), np.zeros(len(xyz), np.int32)
    poses, shifts = np.array([v.pose for v in views]), np.array([v.shift for v in views])
    through, met = _count(xyz, poses, shifts, np.array([v.clear for v in views]), how.margin)
    return through, met


def lies_on_ground(voxels: Voxels) -> NDArray[np.bool_]:
    """Mark the entries ``(M,)`` of the ground's classes that are not higher than a step above the ground of their column."""
    ground = _IS_GROUND[voxels.classes]
    if not ground.any():
        return ground
    at = np.floor(voxels.xyz[ground, :2] / _CELL).astype(np.int64)
    _, column = np.unique(at, axis=0, return_inverse=True)
    column = column.ravel()
    lowest = np.full(column.max() + 1, np.inf)
    np.minimum.at(lowest, column, voxels.xyz[ground, 2])
    ground[ground] = voxels.xyz[ground, 2] < lowest[column] + _STEP
    return ground


@njit(cache=True)
def _count(
    xyz: F64, poses: F64, shifts: F64, clear: NDArray[np.uint16], least: float
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    through, met = np.zeros(len(xyz), np.int32), np.zeros(len(xyz), np.int32)
    for i in range(len(xyz)):
        for k in range(len(poses)):
            dx, dy, dz = xyz[i, 0] - poses[k, 0, 3], xyz[i, 1] - poses[k, 1, 3], xyz[i, 2] - poses[k, 2, 3]
            if dx * dx + dy * dy + dz * dz > REACH * REACH:
                continue
            x = dx * poses[k, 0, 0] + dy * poses[k, 1, 0] + dz * poses[k, 2, 0]
            y = dx * poses[k, 0, 1] + dy * poses[k, 1, 1] + dz * poses[k, 2, 1]
            z = dx * poses[k, 0, 2] + dy * poses[k, 1, 2] + dz * poses[k, 2, 2]
            row, column, reach = pixel_of(x, y, z, shifts[k])
            if row < 0 or row >= ROWS:
                continue
            margin = least + _MARGIN_PER_METRE * reach
            beyond = 0.01 * clear[k, row, column] - reach
            through[i] += beyond > margin
            met[i] += -margin < beyond <= margin
    return through, met
