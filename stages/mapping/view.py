"""How far a scan saw in each direction: the evidence that a place was empty.

A view is a panorama of ranges, 0.5 degree high and 0.35 degree wide a pixel, made from the points alone, so it
serves any spinning sensor. A pixel holds the shortest range in the nine pixels around it: whatever was nearer
than that, the scan would have seen. Where a return is missing between others, it may have been swallowed, or dropped
with what can move, and nothing is known.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

F64 = NDArray[np.float64]

ROWS, COLUMNS = 128, 1024
TOP = math.radians(32.0)  # elevation of the upper edge
PITCH = math.radians(0.5)  # rows


@dataclass(frozen=True, eq=False)
class View:
    """One scan's view.

    Attributes:
        pose: ``(4, 4)`` sensor to map.
        shift: ``(3,)`` way of the sensor during the turn, metres: it stood at ``s * shift`` when it measured
            the azimuth ``2 pi s``.
        clear: ``(ROWS, COLUMNS)`` uint16, centimetres that are certainly free; 0 where nothing is known.
    """

    pose: F64
    shift: F64
    clear: NDArray[np.uint16]


def view_of(points: NDArray[np.float32], motion: F64 | None, pose: F64) -> View:
    """Make the view of a scan's points ``(N, 3)``; ``motion`` is the scan's ``(v, w)`` or None."""
    shift = np.zeros(3) if motion is None else motion[:3].copy()
    return View(pose, shift, _render(points.astype(np.float32), shift))


@njit(cache=True)
def pixel_of(x: float, y: float, z: float, shift: F64) -> tuple[int, int, float]:
    """Return row, column and range of a point of the sensor's frame; the row may be off the panorama."""
    s = math.atan2(y, x) / (2.0 * math.pi)
    x -= s * shift[0]
    y -= s * shift[1]
    z -= s * shift[2]
    flat = math.sqrt(x * x + y * y)
    row = math.floor((TOP - math.atan2(z, flat)) / PITCH)
    column = math.floor((math.atan2(y, x) / (2.0 * math.pi) + 0.5) * COLUMNS) % COLUMNS
    return row, column, math.sqrt(flat * flat + z * z)


@njit(cache=True)
def _render(points: NDArray[np.float32], shift: F64) -> NDArray[np.uint16]:
    nearest = np.zeros((ROWS, COLUMNS), np.uint16)
    for i in range(len(points)):
        x, y, z = np.float64(points[i, 0]), np.float64(points[i, 1]), np.float64(points[i, 2])
        if not (abs(x) < 1e4 and abs(y) < 1e4 and abs(z) < 1e4):
            continue
        row, column, reach = pixel_of(x, y, z, shift)
        if row < 0 or row >= ROWS or reach < 0.5:
            continue
        far = np.uint16(min(65535.0, 100.0 * reach))
        if nearest[row, column] == 0 or far < nearest[row, column]:
            nearest[row, column] = far
    clear = np.zeros((ROWS, COLUMNS), np.uint16)
    for row in range(ROWS):
        for column in range(COLUMNS):
            least, whole, broken = 65535, 0, 0
            for r in range(max(0, row - 1), min(ROWS, row + 2)):
                seen = 0
                for c in range(column - 1, column + 2):
                    value = np.int64(nearest[r, c % COLUMNS])
                    if value > 0:
                        seen += 1
                        least = min(least, int(value))
                whole += seen == 3
                broken += 0 < seen < 3
            if whole and not broken:
                clear[row, column] = least
    return clear
