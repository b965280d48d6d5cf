"""The uniform grid: eq. (1), the nearest return stays, and what is lost is known."""

from dataclasses import replace

import numpy as np

from salpcc.schemas.scan import Scan
from salpcc.stages.ingest.paper_grid import (
    DEGREE,
    FIELD,
    UP,
    grid_points,
    grid_to_scan,
    nearest_of_cells,
    row_elevations,
    scan_to_grid,
    source_of,
)


def _scan(points: np.ndarray) -> Scan:
    n = len(points)
    return Scan(
        "0",
        points.astype(np.float32),
        np.linspace(0, 1, n).astype(np.float32),
        classes=np.full(n, 9, np.uint8),
    )


def test_cells_are_those_of_the_formula(make_scan) -> None:
    points = make_scan(stride=8).points
    stay, level = nearest_of_cells(points, 0.001)
    x, y, z = points[stay].astype(np.float64).T
    r = np.sqrt(x * x + y * y + z * z)
    row = np.clip(np.floor((UP - np.arcsin(z / r)) / FIELD * 64), 0, 63).astype(int)
    column = np.floor((1 - np.arctan2(y, x) / np.pi) / 2 * 2000).astype(int) % 2000
    assert (row * 2000 + column == np.flatnonzero(level)).mean() > 0.9999  # but for rounding at an edge
    assert (level.ravel()[np.flatnonzero(level)] == np.rint(r / 0.001)).mean() > 0.9999


def test_the_nearest_point_of_a_cell_stays() -> None:
    far, near = np.array([10.0, 0.01, -1.0]), np.array([5.0, 0.005, -0.5])
    stay, level = nearest_of_cells(np.array([far, near, -far]), 0.01)
    assert sorted(stay.tolist()) == [1, 2]
    assert level.max() == np.rint(np.linalg.norm(far) / 0.01)


def test_points_without_a_place_are_lost_not_fatal() -> None:
    points = np.array([[np.nan, 0, 0], [np.inf, 1, 1], [0, 0, 0], [1e6, 0, 0], [5, 1, -1]])
    stay, _ = nearest_of_cells(points, 0.001)
    assert stay.tolist() == [4]


def test_points_come_back_on_their_beams(make_scan) -> None:
    scan = make_scan(stride=8)
    grid = scan_to_grid(scan, 0.001, row_elevations([scan.points]))
    stay, _ = nearest_of_cells(scan.points, 0.001)
    back = grid_points(grid)
    ranges = np.linalg.norm(scan.points[stay], axis=1)
    assert np.abs(np.linalg.norm(back, axis=1) - ranges).max() < 0.00051
    off = np.linalg.norm(back - scan.points[stay], axis=1)
    assert (
        off < ranges * (0.6 * DEGREE)
    ).mean() > 0.95  # rows at the edges take what is beyond the field of view
    assert len(grid) < len(scan) == grid.n_points


def test_mean_elevations_are_nearer_than_centres(make_scan) -> None:
    scan = make_scan(stride=8)
    elevation = row_elevations([scan.points])
    centres = row_elevations([])
    errors = []
    for rows in (elevation, centres):
        stay, _ = nearest_of_cells(scan.points, 0.001)
        back = grid_points(scan_to_grid(scan, 0.001, rows))
        errors.append(np.square(back - scan.points[stay]).sum())
    assert errors[0] < errors[1]


def test_every_decoded_point_knows_its_source(make_scan) -> None:
    scan = make_scan(stride=8)
    decoded = grid_to_scan(scan_to_grid(scan, 0.005, row_elevations([scan.points])))
    index = source_of(decoded, scan, 0.005)
    assert index is not None
    assert (
        np.sort(index) == np.sort(nearest_of_cells(scan.points, 0.005)[0])
    ).mean() > 0.95  # the others share cell, level and intensity
    assert (scan.intensity[index] == decoded.intensity).all()
    other = replace(scan, points=scan.points * np.float32(1.01))
    assert source_of(decoded, other, 0.005) is None


def test_an_empty_scan_is_an_empty_grid() -> None:
    scan = _scan(np.zeros((0, 3)))
    grid = scan_to_grid(scan, 0.001, row_elevations([scan.points]))
    assert len(grid) == 0 and not grid.level.any()
    assert len(grid_to_scan(grid)) == 0
