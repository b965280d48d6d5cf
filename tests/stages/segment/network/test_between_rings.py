"""Between rings a surface goes on as a plane; images that have every row stay as they are."""

import numpy as np
import pytest

from salpcc.stages.lattice.sensor_model import load_sensor
from salpcc.stages.segment.network.between_rings import fill_between_rings, has_gaps
from salpcc.stages.segment.network.projection import project
from salpcc.stages.segment.network.range_image import COLUMNS, HEIGHT, RANGE, X, Z


def _street(every: int, columns: int = COLUMNS) -> np.ndarray:
    """Return returns ``(N, 3)`` of the ground, 1.75 m below, and of a wall 12 m ahead, by every so many of the 64 lasers."""
    cones = load_sensor("hdl64e")
    tangent, z0 = np.tan(cones.theta[::every]), cones.z0[::every]
    azimuth = np.pi - (np.arange(columns) + 0.5) * (2 * np.pi / columns)
    down = np.where(tangent < -0.03, (-1.75 - z0) / np.minimum(tangent, -0.03), np.inf)
    rho = np.minimum(
        down[:, None], np.where(np.cos(azimuth) > 0.2, 12 / np.maximum(np.cos(azimuth), 0.2), 110)
    )
    z = z0[:, None] + rho * tangent[:, None]
    points = np.stack([rho * np.cos(azimuth), rho * np.sin(azimuth), z], -1).reshape(-1, 3)
    return points[np.linalg.norm(points, axis=1) < 100].astype(np.float32)


def test_a_sensor_with_every_row_keeps_its_image() -> None:
    points = _street(1)
    image = project(points, np.zeros(len(points), np.float32))
    assert not has_gaps(image.index) and not image.filled
    shown = image.index[image.index >= 0]
    assert len(np.unique(shown)) == len(shown)


@pytest.mark.parametrize(("every", "columns"), [(2, COLUMNS), (4, COLUMNS), (1, 1024), (3, 1024), (3, 1800)])
def test_fewer_rings_see_what_all_would(every: int, columns: int) -> None:
    whole, few = _street(1), _street(every, columns)
    wanted = project(whole, np.zeros(len(whole), np.float32))
    got = project(few, np.zeros(len(few), np.float32))
    filled = got.index >= 0
    assert filled.sum() > 0.9 * (wanted.index >= 0).sum()
    both = filled & (wanted.index >= 0)
    off = np.abs(got.planes[:, both] - wanted.planes[:, both])
    near = wanted.planes[RANGE][both] < 30
    assert (off[RANGE] < 0.02 * wanted.planes[RANGE][both])[near].mean() > 0.9
    assert (off[HEIGHT] < 0.1)[near].mean() > 0.9
    assert (got.planes[:, ~filled] == 0).all()


def test_a_gap_in_depth_is_not_bridged() -> None:
    planes, index = np.zeros((6, 9, 4), np.float32), np.full((9, 4), -1, np.int32)
    planes[RANGE, 0], planes[X, 0], index[0] = 40, 40, [0, 1, 2, 3]
    planes[RANGE, 8], planes[X, 8], index[8] = 8, 8, [4, 5, 6, 7]
    planes[HEIGHT] = 2
    assert has_gaps(index)
    fill_between_rings(planes, index)
    assert sorted(set(planes[RANGE].ravel().tolist())) == [8, 40]
    assert index[3].tolist() == [0, 1, 2, 3] and index[5].tolist() == [4, 5, 6, 7]


def test_a_plane_is_met_on_the_way() -> None:
    planes, index = np.zeros((6, 5, 1), np.float32), np.full((5, 1), -1, np.int32)
    slopes = np.linspace(-0.5, -0.4, 5)  # rays down to the ground 2 m below
    for row in (0, 4):
        x = -2.0 / slopes[row]
        planes[[X, Z, RANGE], row, 0], index[row] = (x, -2, np.hypot(x, 2)), row
    fill_between_rings(planes, index)
    assert planes[Z, :, 0] == pytest.approx(-2.0, abs=1e-5)
    assert np.diff(planes[X, :, 0]).min() > 0
    assert planes[RANGE, :, 0] == pytest.approx(np.hypot(planes[X, :, 0], 2.0), rel=1e-5)
