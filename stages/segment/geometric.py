"""A plain geometric split into ground and other, for runs without labels or a network.

Ground is what lies near the lowest returns around it: a grid in the plane holds the lowest height per
cell, held down by its neighbours'. Nothing is ever called movable, so nothing is dropped.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.schemas.labels import CLASSES

GROUND_CLASS = next(i for i, c in enumerate(CLASSES) if c.name == "ground")
OTHER_CLASS = 0
_CELL = 1.5  # metres
_REACH = 40.0
_SIDE = int(2 * _REACH / _CELL) + 1
_AROUND = 5  # cells
_THICKNESS = 0.15
_BELOW_SENSOR = -1.0  # the sensor rides 1.7 m above the road
_SLOPE = 0.12


@njit(cache=True)
def _cell(x: float, y: float, z: float) -> int:
    """Index of the grid cell of a point, -1 off the grid (and for NaN)."""
    if not (abs(x) < _REACH and abs(y) < _REACH and z < 5.0):
        return -1
    return int((x + _REACH) / _CELL) * _SIDE + int((y + _REACH) / _CELL)


@njit(cache=True)
def _lowest(points: NDArray[np.float32]) -> NDArray[np.float64]:
    lowest = np.full(_SIDE * _SIDE, np.inf)
    for i in range(len(points)):
        cell = _cell(points[i, 0], points[i, 1], points[i, 2])
        if cell >= 0 and points[i, 2] < lowest[cell]:
            lowest[cell] = points[i, 2]
    return lowest


@njit(cache=True)
def _near_floor(points: NDArray[np.float32], floor: NDArray[np.float64]) -> NDArray[np.bool_]:
    near = np.zeros(len(points), np.bool_)
    for i in range(len(points)):
        x = points[i, 0]
        y = points[i, 1]
        z = points[i, 2]
        cell = _cell(x, y, z)
        near[i] = (
            cell >= 0 and z - floor[cell] < _THICKNESS and z < _BELOW_SENSOR + _SLOPE * np.sqrt(x * x + y * y)
        )
    return near


def split_ground(points: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Return a class per point ``(N, 3)``: ground or other (unlabelled)."""
    from scipy.ndimage import minimum_filter

    lowest = _lowest(points)
    # A cell whose lowest return stands above its neighbourhood's holds no ground.
    around = minimum_filter(lowest.reshape(_SIDE, _SIDE), _AROUND, mode="nearest").ravel()
    floor = np.minimum(lowest, around + 2 * _SLOPE * _CELL)
    return np.where(_near_floor(points, floor), np.uint8(GROUND_CLASS), np.uint8(OTHER_CLASS))
