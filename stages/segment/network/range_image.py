"""Range image: the grid of section IV that the network sees.

Columns are the azimuth of eq. (1); rows are the cones of a 64-laser sensor, nearest in elevation.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numba import njit
from numpy.typing import NDArray

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
        index: ``(64, W)`` int32, the point that each pixel shows (the nearest of those in it; between rings that of
            the nearer one), -1 if none.
        row, column: ``(N,)`` int32, the pixel of each point, -1 for points that have none (NaN, origin, steep ones).
        distance: ``(N,)`` float32, the range of each point that has a pixel; of steep ones that of the pixel.
        filled: whether there were gaps between rings or firings, which the 64-laser sensor does not have.
    """

    planes: F32
    index: NDArray[np.int32]
    row: NDArray[np.int32]
    column: NDArray[np.int32]
    distance: F32
    filled: bool

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


@njit(cache=True, inline="always")
def in_reach(x: float, y: float, z: float) -> bool:
    """Tell whether a point is a return: those that are NaN, at the origin or too far away are none."""
    return NEAREST**2 < x * x + y * y + z * z < FARTHEST**2  # NaN fails both


@njit(cache=True)
def nearest_cone(x: float, y: float, z: float, tangent: F64, z0: F64, start: int) -> int:
    """Return the row of the cone that a point is vertically nearest to; -1 out of reach.

    ``start`` is where to look first, such as the row of the point before.
    """
    x, y, z = np.float64(x), np.float64(y), np.float64(z)
    if not in_reach(x, y, z):
        return -1
    rho = np.sqrt(x * x + y * y)
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
