"""Carve: find what several scans contradict, having seen through the place where it is said to be.

A voxel that few scans met and several looked through held something that moved. What was met as often as it
was looked through stays: leaves, fences, edges. Ground is never carved: it is grazed, not looked through.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.schemas.labels import GROUND, GROUP_OF_CLASS
from salpcc.stages.mapping.view import ROWS, View, pixel_of
from salpcc.stages.mapping.voxel import Voxels

F64 = NDArray[np.float64]

REACH = 40.0  # metres; beyond, the beams are too far apart to see through a place
_FEWEST = 2  # views that must contradict
_SHARE = 0.5  # and how many per scan that met the voxel
_MARGIN, _MARGIN_PER_METRE = 0.3, 0.01  # metres by which a view must have seen beyond

_IS_GROUND = np.zeros(256, np.bool_)
_IS_GROUND[: len(GROUP_OF_CLASS)] = GROUP_OF_CLASS == GROUND


def contradicted(voxels: Voxels, views: list[View]) -> NDArray[np.bool_]:
    """Mark the entries ``(M,)`` that enough views looked through. Places are in the frame of the views' poses."""
    if not views or not len(voxels):
        return np.zeros(len(voxels), np.bool_)
    poses = np.array([view.pose for view in views])
    needed = np.maximum(_FEWEST, np.ceil(_SHARE * voxels.scans)).astype(np.int64)
    needed[_IS_GROUND[voxels.classes]] = len(views) + 1
    return np.asarray(
        _seen_through(
            voxels.xyz, needed, poses, np.array([v.shift for v in views]), np.array([v.clear for v in views])
        )
    )


@njit(cache=True)
def _seen_through(
    xyz: F64, needed: NDArray[np.int64], poses: F64, shifts: F64, clear: NDArray[np.uint16]
) -> NDArray[np.bool_]:
    n_views = len(poses)
    out = np.zeros(len(xyz), np.bool_)
    for i in range(len(xyz)):
        missing = needed[i]
        for k in range(n_views):
            if missing == 0 or missing > n_views - k:
                break
            dx, dy, dz = xyz[i, 0] - poses[k, 0, 3], xyz[i, 1] - poses[k, 1, 3], xyz[i, 2] - poses[k, 2, 3]
            if dx * dx + dy * dy + dz * dz > REACH * REACH:
                continue
            x = dx * poses[k, 0, 0] + dy * poses[k, 1, 0] + dz * poses[k, 2, 0]
            y = dx * poses[k, 0, 1] + dy * poses[k, 1, 1] + dz * poses[k, 2, 1]
            z = dx * poses[k, 0, 2] + dy * poses[k, 1, 2] + dz * poses[k, 2, 2]
            row, column, reach = pixel_of(x, y, z, shifts[k])
            if row < 0 or row >= ROWS:
                continue
            if 0.01 * clear[k, row, column] > reach + _MARGIN + _MARGIN_PER_METRE * reach:
                missing -= 1
        out[i] = missing == 0
    return out
