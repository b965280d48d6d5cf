"""A plain geometric split into ground and other, for runs without labels or a network.

Ground is what lies near the lowest returns around it: a grid in the plane holds the lowest height per
cell, smoothed by its neighbours; nothing is ever called movable, so nothing is dropped.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from salpcc.schemas.labels import CLASSES

GROUND_CLASS = next(i for i, c in enumerate(CLASSES) if c.name == "ground")
OTHER_CLASS = 0
_CELL = 1.5  # metres
_REACH = 40.0
_THICKNESS = 0.15
_BELOW_SENSOR = -1.0  # the sensor rides 1.7 m above the road
_SLOPE = 0.12


def split_ground(points: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Return a class per point ``(N, 3)``: ground or other (unlabelled)."""
    classes = np.full(len(points), OTHER_CLASS, np.uint8)
    with np.errstate(invalid="ignore"):
        near = np.flatnonzero((np.abs(points[:, :2]) < _REACH).all(axis=1) & (points[:, 2] < 5.0))
    if len(near) == 0:
        return classes
    side = int(2 * _REACH / _CELL) + 1
    cell = ((points[near, :2] + _REACH) / _CELL).astype(np.int64)
    lowest = np.full((side, side), np.inf)
    np.minimum.at(lowest, (cell[:, 0], cell[:, 1]), points[near, 2])
    # A cell whose lowest return stands above its neighbourhood's holds no ground.
    padded = np.pad(lowest, 2, constant_values=np.inf)
    around = np.min([padded[i : i + side, j : j + side] for i in range(5) for j in range(5)], axis=0)
    floor = np.minimum(lowest, around + 2 * _SLOPE * _CELL)
    height = points[near, 2] - floor[cell[:, 0], cell[:, 1]]
    distance = np.hypot(points[near, 0], points[near, 1])
    low_enough = points[near, 2] < _BELOW_SENSOR + _SLOPE * distance
    classes[near[(height < _THICKNESS) & low_enough]] = GROUND_CLASS
    return classes
