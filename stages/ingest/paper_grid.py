"""The uniform range image of the paper, eq. (1): points <-> cells of 64 x 2000, and levels of range.

    row    = floor((f_up - asin(z / r)) / f * 64)          f_up = 2 deg, f = 26.9 deg
    column = floor((1 - atan2(y, x) / pi) / 2 * 2000)

The grid is uniform and the sensor is not: points that fall into one cell leave the nearest, the others are lost
and counted. A point comes back on the beam through its cell: the column's centre, the row's mean elevation.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.schemas.grid import COLUMNS, ROWS, GridSweep
from salpcc.schemas.scan import Scan
from salpcc.stages.lattice.trig import PI, arctan2, sin_cos

DEGREE = PI / 180.0
UP, FIELD = 2.0 * DEGREE, 26.9 * DEGREE
LEVEL_LIMIT = 1 << 24
ELEVATION_UNIT = 0.001 * DEGREE


@njit(cache=True, error_model="numpy")
def cell_of(x: float, y: float, z: float) -> int:
    """Return the cell ``row * 2000 + column`` of a direction; rows beyond the field of view are the outer ones."""
    elevation = arctan2(z, np.sqrt(x * x + y * y))
    row = int(np.floor((UP - elevation) / FIELD * ROWS))
    column = int(np.floor((1.0 - arctan2(y, x) / PI) / 2.0 * COLUMNS))
    return min(max(row, 0), ROWS - 1) * COLUMNS + column % COLUMNS


@njit(cache=True, error_model="numpy")
def _cells(
    points: NDArray[np.float32], accuracy: float
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
    """Cell (-1: none), level and range of each point."""
    n = len(points)
    cell = np.full(n, -1)
    level = np.zeros(n, np.int64)
    reach = np.zeros(n)
    for i in range(n):
        x, y, z = np.float64(points[i, 0]), np.float64(points[i, 1]), np.float64(points[i, 2])
        r = np.sqrt(x * x + y * y + z * z)
        if not 0.0 < r < (LEVEL_LIMIT - 1) * accuracy:  # NaN and Inf are not
            continue
        cell[i] = cell_of(x, y, z)
        level[i] = max(int(np.floor(r / accuracy + 0.5)), 1)
        reach[i] = r
    return cell, level, reach


def nearest_of_cells(
    points: NDArray[np.float32], accuracy: float
) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    """Return which points ``(M,)`` stay, by ascending cell, and the level image ``(64, 2000)`` they make."""
    cell, level, reach = _cells(np.ascontiguousarray(points, np.float32), accuracy)
    order = np.lexsort((reach, cell))
    order = order[cell[order] >= 0]
    first = np.ones(len(order), np.bool_)
    first[1:] = cell[order[1:]] != cell[order[:-1]]
    stay = order[first]
    image = np.zeros(ROWS * COLUMNS, np.int32)
    image[cell[stay]] = level[stay]
    return stay, image.reshape(ROWS, COLUMNS)


def row_elevations(points: list[NDArray[np.float32]]) -> NDArray[np.int16]:
    """Return the mean elevation ``(64,)`` of the points of each row over some scans, thousandths of a degree.

    A row without points has that of its centre. *Why not the centre everywhere:* the lasers are not spaced
    evenly, and a row's mean is nearer to where its points came from.
    """
    total, count = np.zeros(ROWS), np.zeros(ROWS)
    for some in points:
        x, y, z = some.astype(np.float64).T
        rows = _cells(np.ascontiguousarray(some, np.float32), 1.0)[0] // COLUMNS
        good = rows >= 0
        elevation = np.arctan2(z[good], np.hypot(x[good], y[good])) / ELEVATION_UNIT
        total += np.bincount(rows[good], elevation, ROWS)
        count += np.bincount(rows[good], minlength=ROWS)
    centre = (UP - (np.arange(ROWS) + 0.5) / ROWS * FIELD) / ELEVATION_UNIT
    mean = np.where(count > 0, total / np.maximum(count, 1), centre)
    return np.clip(np.rint(mean), -32767, 32767).astype(np.int16)


@njit(cache=True, error_model="numpy")
def directions(elevation: NDArray[np.int16]) -> NDArray[np.float64]:
    """Return the unit vectors ``(64 * 2000, 3)`` of the beams through the cells, by cell."""
    out = np.empty((ROWS * COLUMNS, 3))
    for row in range(ROWS):
        up, flat = sin_cos(np.float64(elevation[row]) * ELEVATION_UNIT)
        for column in range(COLUMNS):
            s, c = sin_cos((1.0 - 2.0 * (column + 0.5) / COLUMNS) * PI)
            cell = row * COLUMNS + column
            out[cell, 0] = flat * c
            out[cell, 1] = flat * s
            out[cell, 2] = up
    return out


def grid_points(sweep: GridSweep) -> NDArray[np.float32]:
    """Return the points ``(M, 3)`` of the filled cells, row by row."""
    filled = np.flatnonzero(sweep.level.ravel())
    reach = sweep.level.ravel()[filled] * sweep.accuracy
    return (directions(sweep.elevation)[filled] * reach[:, None]).astype(np.float32)


def scan_to_grid(
    scan: Scan, accuracy: float, elevation: NDArray[np.int16], n_points: int | None = None
) -> GridSweep:
    """Put a scan on the grid at ``accuracy`` metres a level; ``n_points`` of the source where it had more."""
    stay, level = nearest_of_cells(scan.points, accuracy)
    return GridSweep(
        name=scan.name,
        time=scan.time,
        frame_id=scan.frame_id,
        n_points=len(scan) if n_points is None else n_points,
        accuracy=accuracy,
        elevation=elevation,
        level=level,
        intensity=scan.intensity[stay],
        classes=None if scan.classes is None else scan.classes[stay],
        motion=scan.motion,
    )


def grid_to_scan(sweep: GridSweep) -> Scan:
    """Return the scan of a grid sweep, points row by row; inverse of :func:`scan_to_grid` but for what it lost."""
    return Scan(
        sweep.name, grid_points(sweep), sweep.intensity, sweep.time, sweep.frame_id, sweep.classes, None
    )


def source_of(decoded: Scan, source: Scan, accuracy: float) -> NDArray[np.int64] | None:
    """Return which source point each decoded point ``(M,)`` came from, or None where one came from none.

    A decoded point stands in the cell, and on the level, of its source point, and has its intensity; nothing
    has to be known of which points the task dropped.
    """
    cell, level, _ = _cells(np.ascontiguousarray(source.points, np.float32), accuracy)
    of_decoded = _cells(np.ascontiguousarray(decoded.points, np.float32), accuracy)
    rows = {}
    bits = np.ascontiguousarray(source.intensity, np.float32).view(np.int32)
    for place in range(len(cell) - 1, -1, -1):
        rows[(cell[place], level[place], bits[place])] = place
    wanted = np.ascontiguousarray(decoded.intensity, np.float32).view(np.int32)
    found = [rows.get(key, -1) for key in zip(of_decoded[0], of_decoded[1], wanted, strict=True)]
    result = np.array(found, np.int64)
    return None if (result < 0).any() else result
