"""Range image: the grid of section IV that the network sees, and the way back to every point.

Columns are the azimuth of eq. (1); rows are the cones of a 64-laser sensor, nearest in elevation. The
image is made from points alone, so one path serves scans on the lattice, raw ones and foreign sensors.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.lattice.sensor_model import SensorModel, load_sensor
from salpcc.stages.segment.ground_height import height_above_ground

F32 = NDArray[np.float32]

ROWS = 64
COLUMNS = 2048
X, Y, Z, RANGE, INTENSITY, HEIGHT = range(6)
PLANES = 6
NEAREST, FARTHEST = 0.5, 130.0  # metres; what lies outside is no return


@dataclass(frozen=True, eq=False)
class RangeImage:
    """A scan on the grid.

    Attributes:
        planes: ``(6, 64, W)`` float32: x, y, z, range, intensity, height above the ground; 0 where empty.
        index: ``(64, W)`` int32, the point that each pixel shows (the nearest of those in it), -1 if none.
        row, column: ``(N,)`` int32, the pixel of each point, -1 for points that have none (NaN, origin).
    """

    planes: F32
    index: NDArray[np.int32]
    row: NDArray[np.int32]
    column: NDArray[np.int32]


@njit(cache=True)
def nearest_cones(points: F32, tangent: NDArray[np.float64], z0: NDArray[np.float64]) -> NDArray[np.int32]:
    """Return the row ``(N,)`` of the cone that each point ``(N, 3)`` is vertically nearest to; -1 out of reach."""
    row = np.full(len(points), -1, np.int32)
    for i in range(len(points)):
        x = np.float64(points[i, 0])
        y = np.float64(points[i, 1])
        z = np.float64(points[i, 2])
        rho = np.sqrt(x * x + y * y)
        distance = np.sqrt(rho * rho + z * z)
        if not (distance > NEAREST and distance < FARTHEST):  # NaN fails both
            continue
        # Cones come top to bottom, so the height of a cone at the point's distance falls with its number.
        below = 0
        end = len(tangent)
        while below < end:
            middle = (below + end) // 2
            if z0[middle] + rho * tangent[middle] > z:
                below = middle + 1
            else:
                end = middle
        row[i] = min(below, len(tangent) - 1)
        if below > 0:
            over = z0[below - 1] + rho * tangent[below - 1] - z
            if below == len(tangent) or over < z - z0[below] - rho * tangent[below]:
                row[i] = below - 1
    return row


@njit(cache=True)
def _nearest_return(
    distance: F32, row: NDArray[np.int32], column: NDArray[np.int32], rows: int, columns: int
) -> NDArray[np.int32]:
    index = np.full((rows, columns), -1, np.int32)
    for i in range(len(row)):
        if row[i] < 0:
            continue
        there = index[row[i], column[i]]
        if there < 0 or distance[i] < distance[there]:
            index[row[i], column[i]] = i
    return index


def project(
    points: F32, intensity: F32, sensor: SensorModel | None = None, columns: int = COLUMNS
) -> RangeImage:
    """Lay points ``(N, 3)`` and intensities ``(N,)`` on the grid; inverse: :mod:`.back_projection`.

    Args:
        sensor: whose cones are the rows, which come top to bottom; by default the HDL-64E's.
    """
    cones = sensor or load_sensor("hdl64e")
    points = np.ascontiguousarray(points, np.float32)
    row = nearest_cones(points, np.tan(cones.theta), cones.z0)
    with np.errstate(all="ignore"):
        turn = 0.5 * (1.0 - np.arctan2(points[:, 1], points[:, 0]).astype(np.float64) / np.pi)
        distance = np.sqrt((points.astype(np.float64) ** 2).sum(axis=1)).astype(np.float32)
    column = np.where(row >= 0, turn * columns, -1.0)
    column = np.minimum(column, columns - 1).astype(np.int32)
    index = _nearest_return(distance, row, column, cones.n_lasers, columns)

    seen = index >= 0
    shown = index[seen]
    planes = np.zeros((PLANES, cones.n_lasers, columns), np.float32)
    planes[X:RANGE, seen] = points[shown].T
    planes[RANGE, seen] = distance[shown]
    planes[INTENSITY, seen] = np.nan_to_num(intensity[shown], posinf=1.0, neginf=0.0).clip(0.0, 1.0)
    planes[HEIGHT, seen] = height_above_ground(points[row >= 0], points[shown])
    return RangeImage(planes, index, row, column)
