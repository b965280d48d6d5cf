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
    places = np.ascontiguousarray(planes.transpose(2, 1, 0))  # a column lies together
    for i in beyond:
        x, y, z = points[i]
        ground_like = height_above(points[i], ground) < _GROUND
        spot = np.float32(_SPOT + _SPOT_BY_RANGE * np.sqrt(x * x + y * y)) ** 2
        best = np.float32(np.inf)  # squares of metres in the plane
        centre = column[i]
        for step in (0, -1, 1):
            b = wrapped(centre + step, columns)
            for a in range(rows):
                dx, dy = places[b, a, X] - x, places[b, a, Y] - y
                off = dx * dx + dy * dy
                if off >= best or places[b, a, RANGE] == 0:
                    continue
                level = ground_like and places[b, a, HEIGHT] < _GROUND
                if level or (off < spot and abs(places[b, a, Z] - z) < _UPRIGHT):
                    best = off
                    row[i], column[i], distance[i] = a, b, places[b, a, RANGE]
