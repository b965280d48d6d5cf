"""Height above the ground: the lowest returns of a grid in the plane, opened so that objects vanish.

It is what tells a car roof from a wall and a kerb from a bush, and needs no labels and no fit.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, gaussian_filter, maximum_filter, minimum_filter

F32 = NDArray[np.float32]

CELL = 1.0  # metres
SIDE = 128  # cells; what lies beyond takes the height of the edge
_OPENING = 7  # cells: longer than a car
_LOWEST = -8.0  # metres; lower returns are reflections in wet or polished ground


@njit(cache=True)
def cell_minima(points: F32, seen: NDArray[np.bool_], side: int = SIDE) -> F32:
    """Return the lowest of the ``seen`` of points ``(N, 3)`` in each cell of 1 m around the sensor, ``(side, side)``; infinity where none is."""
    lowest = np.full((side, side), np.inf, np.float32)
    for i in range(len(points)):
        z = points[i, 2]
        if not seen[i] or z < _LOWEST:
            continue
        a = int(np.floor(points[i, 0] / CELL)) + side // 2
        b = int(np.floor(points[i, 1] / CELL)) + side // 2
        if 0 <= a < side and 0 <= b < side and z < lowest[a, b]:
            lowest[a, b] = z
    return lowest


@njit(cache=True)
def height_above(point: F32, ground: F32) -> float:
    """Return how far a point ``(3,)`` is above the bilinear ``ground``."""
    side = len(ground)
    u = min(max(point[0] / CELL + side / 2 - 0.5, 0.0), side - 1.001)
    v = min(max(point[1] / CELL + side / 2 - 0.5, 0.0), side - 1.001)
    a = int(u)
    b = int(v)
    s = u - a
    t = v - b
    near = ground[a, b] * (1 - t) + ground[a, b + 1] * t
    far = ground[a + 1, b] * (1 - t) + ground[a + 1, b + 1] * t
    return point[2] - (near * (1 - s) + far * s)


@njit(cache=True)
def put_heights(height: F32, points: F32, index: NDArray[np.int32], ground: F32) -> None:
    """Write into ``height`` ``(H, W)`` how far the points ``index`` ``(H, W)`` are above the ``ground``; -1 are none."""
    for row in range(index.shape[0]):
        for column in range(index.shape[1]):
            i = index[row, column]
            if i >= 0:
                height[row, column] = height_above(points[i], ground)


def opened(lowest: F32) -> F32:
    """Open cell minima ``(side, side)``, of which some are finite: the height of the ground below what stands on it."""
    eroded = minimum_filter(lowest, _OPENING, mode="nearest")
    ground = maximum_filter(np.where(np.isfinite(eroded), eroded, -np.inf), _OPENING, mode="nearest")
    holes = ~np.isfinite(ground)
    if holes.any():
        nearest = distance_transform_edt(holes, return_distances=False, return_indices=True)
        ground = ground[tuple(nearest)]
    return ground


def ground_surface(points: F32, seen: NDArray[np.bool_]) -> F32:
    """Return the height of the ground ``(128, 128)`` in cells of 1 m around the sensor, from the ``seen`` of points ``(N, 3)``."""
    lowest = cell_minima(points, seen)
    if not np.isfinite(lowest).any():
        return np.zeros_like(lowest)
    return gaussian_filter(opened(lowest), 1.0, mode="nearest")
