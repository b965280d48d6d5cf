"""Heights above the ground: objects stand on it, slopes do not fool it."""

import numpy as np
import pytest

from salpcc.stages.segment.network.ground_height import ground_surface, put_heights


def _heights(cloud: np.ndarray, points: np.ndarray) -> np.ndarray:
    height = np.zeros((1, len(points)), np.float32)
    index = np.arange(len(points), dtype=np.int32)[None]
    put_heights(height, points, index, ground_surface(cloud, np.ones(len(cloud), np.bool_)))
    return height[0]


@pytest.mark.parametrize("slope", [0.0, 0.06])
def test_a_box_on_a_slope(slope: float) -> None:
    rng = np.random.default_rng(0)
    floor = np.column_stack([rng.uniform(-30, 30, (40000, 2)), np.zeros(40000)])
    box = np.column_stack([rng.uniform(8, 11, (800, 2)), rng.uniform(0.3, 1.5, 800)])
    cloud = np.concatenate([floor, box])
    cloud[:, 2] += slope * cloud[:, 0] - 1.7
    height = _heights(cloud.astype(np.float32), cloud.astype(np.float32))
    inner = np.abs(cloud[:, :2]).max(axis=1) < 25
    assert np.abs(height[inner & (np.arange(len(cloud)) < 40000)]).max() < 0.1 + 3 * slope
    assert np.abs(height[40000:] - box[:, 2]).max() < 0.1 + 3 * slope


def test_no_points_at_all() -> None:
    nothing = np.zeros((0, 3), np.float32)
    assert _heights(nothing, np.ones((2, 3), np.float32)).tolist() == [1, 1]


def test_what_has_no_pixel_is_no_ground_and_gets_no_height() -> None:
    points = np.float32([[5, 5, 0], [5.5, 5.5, -3]])
    ground = ground_surface(points, np.array([True, False]))
    assert (ground == 0).all()
    height = np.full((1, 2), 7, np.float32)
    put_heights(height, points, np.int32([[-1, 1]]), ground)
    assert height.tolist() == [[7, -3]]
