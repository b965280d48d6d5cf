"""Range image: the grid of section IV that the network sees, and the way back to every point.

Columns are the azimuth of eq. (1); rows are the cones of a 64-laser sensor, nearest in elevation. The
image is made from points alone, so one path serves scans on the lattice, raw ones and foreign sensors.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.lattice.sensor_model import SensorModel, load_sensor
from salpcc.stages.segment.network.ground_height import ground_surface, put_heights

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I32 = NDArray[np.int32]

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
        distance: ``(N,)`` float32, the range of each point that has a pixel.
    """

    planes: F32
    index: NDArray[np.int32]
    row: NDArray[np.int32]
    column: NDArray[np.int32]
    distance: F32

    @cached_property
    def places(self) -> F32:
        """Return x, y, z, range of each pixel ``(64, W, 4)``, which lie together; where there is no return, infinity."""
        return _places(self.planes, self.index)


@njit(cache=True)
def _places(planes: F32, index: I32) -> F32:
    rows, columns = index.shape
    out = np.empty((rows, columns, RANGE + 1), np.float32)
    for i in range(rows):
        for j in range(columns):
            for k in range(RANGE + 1):
                out[i, j, k] = planes[k, i, j] if index[i, j] >= 0 else np.float32(np.inf)
    return out


@njit(cache=True, inline="always")
def wrapped(column: int, columns: int) -> int:
    """Return the column of a turn that is counted on beyond its ends; a division takes longer than all that is asked of it."""
    if column < 0:
        return column + columns
    return column - columns if column >= columns else column


@njit(cache=True)
def nearest_cone(x: float, y: float, z: float, tangent: F64, z0: F64, start: int) -> int:
    """Return the row of the cone that a point is vertically nearest to; -1 out of reach.

    ``start`` is where to look first, such as the row of the point before.
    """
    x, y, z = np.float64(x), np.float64(y), np.float64(z)
    square = x * x + y * y
    if not NEAREST**2 < square + z * z < FARTHEST**2:  # NaN fails both
        return -1
    rho = np.sqrt(square)
    # Cones come top to bottom, so the height of a cone at the point's distance falls with its number.
    below = max(start, 0)
    while below < len(tangent) and z0[below] + rho * tangent[below] > z:
        below += 1
    while below > 0 and not z0[below - 1] + rho * tangent[below - 1] > z:
        below -= 1
    if below > 0:
        over = z0[below - 1] + rho * tangent[below - 1] - z
        if below == len(tangent) or over < z - z0[below] - rho * tangent[below]:
            return below - 1
    return below


@njit(cache=True)
def _pixels(points: F32, azimuth: F32, tangent: F64, z0: F64, columns: int) -> tuple[I32, I32, F32, I32]:
    """Return row, column and distance ``(N,)`` of each point, and the point ``(H, W)`` that each pixel shows."""
    row = np.full(len(points), -1, np.int32)
    column = np.full(len(points), -1, np.int32)
    distance = np.zeros(len(points), np.float32)
    index = np.full((len(tangent), columns), -1, np.int32)
    a = 0
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        a = nearest_cone(x, y, z, tangent, z0, a)
        if a < 0:
            continue
        b = min(int(0.5 * (1.0 - azimuth[i] / np.pi) * columns), columns - 1)
        row[i] = a
        column[i] = b
        distance[i] = np.sqrt(np.float64(x) * x + np.float64(y) * y + np.float64(z) * z)
        there = index[a, b]
        if there < 0 or distance[i] < distance[there]:
            index[a, b] = i
    return row, column, distance, index


@njit(cache=True)
def _shown(points: F32, intensity: F32, distance: F32, index: I32) -> F32:
    """Return the planes of an image but for heights, which are 0."""
    rows, columns = index.shape
    planes = np.zeros((PLANES, rows, columns), np.float32)
    for a in range(rows):
        for b in range(columns):
            i = index[a, b]
            if i < 0:
                continue
            for axis in range(3):
                planes[axis, a, b] = points[i, axis]
            planes[RANGE, a, b] = distance[i]
            if intensity[i] > 0:  # NaN is not
                planes[INTENSITY, a, b] = min(intensity[i], np.float32(1.0))
    return planes


def project(
    points: F32, intensity: F32, sensor: SensorModel | None = None, columns: int = COLUMNS
) -> RangeImage:
    """Lay points ``(N, 3)`` and intensities ``(N,)`` on the grid; inverse: :mod:`salpcc.stages.segment.back_projection`.

    Args:
        sensor: whose cones are the rows, which come top to bottom; by default the HDL-64E's.
    """
    cones = sensor or load_sensor("hdl64e")
    points = np.ascontiguousarray(points, np.float32)
    with np.errstate(all="ignore"):
        azimuth = np.arctan2(points[:, 1], points[:, 0])
    row, column, distance, index = _pixels(points, azimuth, np.tan(cones.theta), cones.z0, columns)
    planes = _shown(points, np.asarray(intensity, np.float32), distance, index)
    put_heights(planes[HEIGHT], points, index, ground_surface(points, row >= 0))
    return RangeImage(planes, index, row, column, distance)
