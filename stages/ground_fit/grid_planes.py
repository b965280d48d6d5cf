"""Planes of a range image's ground: fitted, chosen, rounded, and what ranges they predict.

A plane is the height at the middle of its region and two slopes, in whole units, so that both sides of the
coder have the same. The beam ``r (dx, dy, dz)`` meets the plane ``z = h + a (x - x0) + b (y - y0)`` at

    r = (h - a x0 - b y0) / (dz - a dx - b dy)
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.schemas.grid import GridSweep
from salpcc.schemas.labels import GROUND, GROUP_OF_CLASS
from salpcc.stages.ground_fit.grid_regions import centres, region_image
from salpcc.stages.ground_fit.plane import fit_plane
from salpcc.stages.ingest.paper_grid import LEVEL_LIMIT, directions

HEIGHT_UNIT = 0.005  # metres; slopes are that over the size of the region
_FEWEST = 6
_ENOUGH = 400  # points beyond these do not move a plane
_TRIMS = (0.1, 0.04)  # metres off the plane; a plane is fitted again to the points within
PLANE_LIMIT = 1 << 20  # of the units


@njit(cache=True, error_model="numpy")
def _predict(
    image: NDArray[np.int32],
    beams: NDArray[np.float64],
    region: NDArray[np.int32],
    middle: NDArray[np.float64],
    planes: NDArray[np.float64],
    accuracy: float,
) -> None:
    """Write the levels at which beams meet the plane of their region; 0 where there is none."""
    for cell in range(len(region)):
        k = region[cell]
        a, b = planes[k, 1], planes[k, 2]
        if planes[k, 3] == 0.0:
            continue
        height = planes[k, 0] - a * middle[k, 0] - b * middle[k, 1]
        fall = beams[cell, 2] - a * beams[cell, 0] - b * beams[cell, 1]
        if fall * height <= 0.0:
            continue
        level = np.floor(height / fall / accuracy + 0.5)
        if 0.0 < level < LEVEL_LIMIT:
            image[cell] = np.int32(level)


def predict_ground(
    planes: NDArray[np.int32], elevation: NDArray[np.int16], accuracy: float
) -> NDArray[np.int32]:
    """Return the levels ``(64, 2000)`` that planes predict; 0 where a region has none.

    Args:
        planes: ``(P, 4)`` int32 rows of region, height and two slopes in units.
    """
    region = region_image(elevation)
    middle = centres()
    values = np.zeros((len(middle), 4))
    for k, height, a, b in planes:
        unit = HEIGHT_UNIT / middle[k, 2]
        values[k] = height * HEIGHT_UNIT, a * unit, b * unit, 1.0
    image = np.zeros(region.size, np.int32)
    _predict(image, directions(elevation), region.ravel(), middle, values, accuracy)
    return image.reshape(region.shape)


def ground_of(sweep: GridSweep) -> NDArray[np.bool_]:
    """Return which cells ``(64, 2000)`` hold ground."""
    ground = np.zeros(sweep.level.shape, np.bool_)
    if sweep.classes is not None:
        ground[np.nonzero(sweep.level)] = GROUP_OF_CLASS[sweep.classes] == GROUND
    return ground


def fit_ground(sweep: GridSweep) -> NDArray[np.int32]:
    """Return the best plane of each region with enough ground, rows ``(P, 4)`` of region, height and slopes in units.

    Candidates are the plane of all the region's ground points, and those of the points near it; the one whose
    ranges are nearest wins, counted in bits.
    """
    if sweep.classes is None or not (GROUP_OF_CLASS[sweep.classes] == GROUND).any():
        return np.zeros((0, 4), np.int32)
    cell = np.flatnonzero(sweep.level.ravel())[GROUP_OF_CLASS[sweep.classes] == GROUND]
    beams, middle = directions(sweep.elevation)[cell], centres()
    reach = sweep.level.ravel()[cell] * sweep.accuracy
    points = beams * reach[:, None]
    region = region_image(sweep.elevation).ravel()[cell]
    order = np.argsort(region, kind="stable")
    numbers, first = np.unique(region[order], return_index=True)
    rows: list[tuple[int, ...]] = []
    for k, inside in zip(numbers, np.split(order, first[1:]), strict=True):
        if len(inside) < _FEWEST:
            continue
        x0, y0, size = middle[k]
        local = points[inside] - np.array([x0, y0, 0.0])
        best: tuple[float, tuple[int, ...]] | None = None
        for plane in _candidates(local):
            units = np.rint(plane / HEIGHT_UNIT * np.array([size, size, 1.0]))[[2, 0, 1]]
            if not (np.abs(units) < PLANE_LIMIT).all():
                continue
            row = (int(k), *(int(u) for u in units))
            cost = _cost(row, beams[inside], reach[inside], middle[k], sweep.accuracy)
            if best is None or cost < best[0]:
                best = cost, row
        if best is not None:
            rows.append(best[1])
    return np.array(rows, np.int32).reshape(-1, 4)


def _candidates(points: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """Planes ``(a, b, c)`` of all points, and of those near the plane before."""
    some = np.ascontiguousarray(points[:: len(points) // _ENOUGH + 1])
    found = [fit_plane(some)]
    for reach in _TRIMS:
        a, b, c = found[-1]
        near = np.abs(a * some[:, 0] + b * some[:, 1] + c - some[:, 2]) < reach
        if near.sum() < _FEWEST or near.all():
            break
        found.append(fit_plane(np.ascontiguousarray(some[near])))
    return found


def _cost(
    row: tuple[int, ...],
    beams: NDArray[np.float64],
    reach: NDArray[np.float64],
    middle: NDArray[np.float64],
    accuracy: float,
) -> float:
    """Bits of the residuals of eq. (11), about."""
    height, a, b = row[1] * HEIGHT_UNIT, row[2] * HEIGHT_UNIT / middle[2], row[3] * HEIGHT_UNIT / middle[2]
    fall = beams[:, 2] - a * beams[:, 0] - b * beams[:, 1]
    with np.errstate(divide="ignore", invalid="ignore"):
        met = (height - a * middle[0] - b * middle[1]) / fall
    off = np.where((met > 0) & (met < 1e4), np.abs(met - reach), reach)
    return float(np.log2(1.0 + off / accuracy).sum())
