"""Points that look steeper up or down than any row of the image: which pixel tells what they are.

What stands above or below the same spot is the same thing, and ground beside ground goes on.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.segment.network.ground_height import height_above
from salpcc.stages.segment.network.range_image import HEIGHT, RANGE, X, Y, Z, wrapped

F32 = NDArray[np.float32]
I32 = NDArray[np.int32]

_SPOT, _SPOT_BY_RANGE = 0.3, 0.01  # metres that one spot is wide, and for every metre of range
_UPRIGHT = 1.5  # metres between a point and what it belongs to, upwards or downwards
_GROUND = 0.2  # metres above the ground that are ground


@njit(cache=True)
def give_pixels(
    points: F32, beyond: NDArray[np.int64], planes: F32, ground: F32, row: I32, column: I32, distance: F32
) -> None:
    """Give the points ``beyond`` ``(M,)`` of ``(N, 3)``, whose column is known, the row and range of the pixel they belong to.

    Those that belong to none keep row -1.
    """
    _, rows, columns = planes.shape
    for i in beyond:
        x, y, z = points[i]
        height = height_above(points[i], ground)
        spot = _SPOT + _SPOT_BY_RANGE * np.sqrt(x * x + y * y)
        best = np.float32(np.inf)
        centre = column[i]
        for step in (0, -1, 1):
            b = wrapped(centre + step, columns)
            for a in range(rows):
                if planes[RANGE, a, b] == 0:
                    continue
                dx, dy = planes[X, a, b] - x, planes[Y, a, b] - y
                off = np.sqrt(dx * dx + dy * dy)
                level = height < _GROUND and planes[HEIGHT, a, b] < _GROUND
                upright = off < spot and abs(planes[Z, a, b] - z) < _UPRIGHT
                if off < best and (level or upright):
                    best = off
                    row[i], column[i], distance[i] = a, b, planes[RANGE, a, b]
