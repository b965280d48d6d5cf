"""Points onto the range image; the inverse is :mod:`salpcc.stages.segment.back_projection`.

The image is made from points alone, so one path serves scans on the lattice, raw ones and other sensors, whose
clouds become what the 64-laser sensor would have seen (:mod:`.view`, :mod:`.between_rings`, :mod:`.beyond_rows`).
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.lattice.sensor_model import load_sensor
from salpcc.stages.segment.network.between_rings import fill_between_rings, has_gaps
from salpcc.stages.segment.network.beyond_rows import give_pixels
from salpcc.stages.segment.network.ground_height import ground_surface, put_heights
from salpcc.stages.segment.network.range_image import (
    COLUMNS,
    HEIGHT,
    INTENSITY,
    PLANES,
    RANGE,
    RangeImage,
    nearest_cone,
)
from salpcc.stages.segment.network.view import AS_IT_IS, View

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I32 = NDArray[np.int32]

_BEYOND = 1.0  # degrees above and below the outermost cones that are still theirs;
_BELOW_OWN = 5.5  # near the 64-laser sensor points lie lower, compensated and raw


@njit(cache=True)
def _pixels(
    points: F32, azimuth: F32, tangent: F64, z0: F64, steepest: tuple[float, float], columns: int
) -> tuple[I32, I32, F32, I32]:
    """Return row, column and distance ``(N,)`` of each point, and the point ``(H, W)`` that each pixel shows.

    What is no return has no column. Points steeper than the tangents ``steepest``, at the top and at the bottom, have no row.
    """
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
        column[i] = b
        if a == 0 or a == len(tangent) - 1:
            rho = np.sqrt(np.float64(x) * x + np.float64(y) * y)
            if z > z0[0] + rho * steepest[0] or z < z0[-1] + rho * steepest[1]:
                continue
        row[i] = a
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


def project(points: F32, intensity: F32, view: View = AS_IT_IS, columns: int = COLUMNS) -> RangeImage:
    """Lay points ``(N, 3)`` and intensities ``(N,)`` on the grid; inverse: :mod:`salpcc.stages.segment.back_projection`.

    Args:
        view: how the cloud is brought to what the network knows.
    """
    cones = load_sensor("hdl64e")
    points = np.ascontiguousarray(points, np.float32)
    if view.lift:
        points = points + np.array([0.0, 0.0, view.lift], np.float32)
    with np.errstate(all="ignore"):
        azimuth = np.arctan2(points[:, 1], points[:, 0])
    tangent = np.tan(cones.theta)
    highest = np.tan(cones.theta[0] + np.radians(_BEYOND))
    for beyond in (_BELOW_OWN, _BEYOND):
        steepest = highest, np.tan(cones.theta[-1] - np.radians(beyond))
        row, column, distance, index = _pixels(points, azimuth, tangent, cones.z0, steepest, columns)
        gaps = has_gaps(index)
        if not gaps:
            break
    planes = _shown(points, np.asarray(intensity, np.float32) * np.float32(view.brightness), distance, index)
    ground = ground_surface(points, column >= 0)
    put_heights(planes[HEIGHT], points, index, ground)
    if gaps:
        fill_between_rings(planes, index)
    steep = np.flatnonzero((row < 0) & (column >= 0))
    give_pixels(points, steep, planes, ground, row, column, distance)
    return RangeImage(planes, index, row, column, distance, gaps)
