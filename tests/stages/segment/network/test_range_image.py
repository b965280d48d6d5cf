"""Points on the grid: their laser's row, eq. (1)'s column, the nearest return of each pixel."""

import numpy as np

from salpcc.stages.lattice.sensor_model import load_sensor
from salpcc.stages.lattice.sweep import scan_to_sweep, source_places
from salpcc.stages.segment.network.projection import project
from salpcc.stages.segment.network.range_image import COLUMNS, INTENSITY, RANGE, wrapped


def test_rows_are_the_lasers_of_the_lattice(make_scan, sensor) -> None:
    scan = make_scan(motion=None)  # compensation moves near points across cones
    sweep = scan_to_sweep(scan, sensor)
    on, _ = source_places(sweep, sensor)
    row = project(scan.points, scan.intensity).row[on]
    assert (row == sweep.laser).mean() > 0.97
    assert np.abs(row - sweep.laser.astype(int)).max() <= 1


def test_columns_follow_the_azimuth() -> None:
    azimuth = np.array([np.pi, np.pi / 2, 0.0, -np.pi / 2, -np.pi + 2e-3]) - 1e-3
    points = np.stack([10 * np.cos(azimuth), 10 * np.sin(azimuth), np.zeros(5)], 1).astype(np.float32)
    column = project(points, np.zeros(5, np.float32)).column
    assert column.tolist() == [0, COLUMNS // 4, COLUMNS // 2, 3 * COLUMNS // 4, COLUMNS - 1]


def test_the_nearest_return_is_shown() -> None:
    cone = load_sensor("hdl64e")
    rho = np.array([20.0, 10.0, 30.0])
    points = np.stack([rho, 0 * rho, cone.z0[20] + rho * np.tan(cone.theta[20])], 1).astype(np.float32)
    image = project(points, np.array([0.1, 0.2, 0.3], np.float32))
    assert len(set(zip(image.row.tolist(), image.column.tolist(), strict=True))) == 1
    at = image.row[0], image.column[0]
    assert image.index[at] == 1 and (image.index >= 0).sum() == 1
    assert (
        abs(image.planes[RANGE][at] - 10) < 0.1
        and image.row[0] == 20
        and image.planes[INTENSITY][at] == np.float32(0.2)
    )


def test_what_is_no_return_has_no_pixel() -> None:
    points = np.array(
        [[np.nan, 0, 0], [np.inf, 1, 1], [0, 0, 0], [1e30, -1e30, 1e30], [500, 0, 0]], np.float32
    )
    image = project(points, np.full(5, np.nan, np.float32))
    assert (image.row == -1).all() and (image.index == -1).all() and not image.planes.any()
    assert len(project(np.zeros((0, 3), np.float32), np.zeros(0, np.float32)).row) == 0


def test_a_turn_has_no_end() -> None:
    assert [wrapped(column, 8) for column in (-3, 0, 7, 8, 10)] == [5, 0, 7, 0, 2]
