"""The range-image baselines: what they do keep is the range of every filled cell, within the asked error."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from salpcc.schemas.scan import Scan
from salpcc.stages.evaluate.baselines import BASELINES
from salpcc.stages.evaluate.baselines.baseline import NotPossible
from salpcc.stages.evaluate.baselines.tile_image import directions, project, to_levels, unproject


@pytest.mark.parametrize("error", [0.002, 0.02, 0.2])
@pytest.mark.parametrize("name", ["png", "hevc_intra", "hevc_inter", "feng", "sun"])
def test_ranges_are_within_the_asked_error(name: str, error: float, street: Callable[..., Scan]) -> None:
    baseline = BASELINES[name]
    if missing := baseline.missing():
        pytest.skip(missing)
    points = street(points=20_000).points
    ranges = project(points)
    decoded = baseline.decode(baseline.encode(points, error))
    assert len(decoded) == np.count_nonzero(ranges)
    off = np.abs(np.linalg.norm(decoded.astype(np.float64), axis=1) - ranges[ranges > 0])
    assert off.max() <= error + 1e-5
    assert off.max() > 0.3 * error


def test_cells_come_back_through_their_centres() -> None:
    points = (directions()[[0, 17, 63], [3, 1000, 1999]] * [[4.0], [8.0], [16.0]]).astype(np.float32)
    ranges = project(points)
    assert np.argwhere(ranges).tolist() == [[0, 3], [17, 1000], [63, 1999]]
    assert np.allclose(unproject(ranges), points, atol=1e-5)


def test_the_nearest_point_of_a_cell_stays() -> None:
    ray = directions()[10, 10]
    assert project(np.stack([9 * ray, 5 * ray, 7 * ray]).astype(np.float32)).max() == pytest.approx(5)


def test_a_range_beyond_16_bits_is_refused() -> None:
    with pytest.raises(NotPossible, match="does not fit 16 bits"):
        to_levels(np.full((1, 1), 200.0), 0.002)


def test_planes_carry_over_many_tiles_of_a_plain_wall() -> None:
    rays = directions()
    wall = np.where(
        (rays[..., 0] > 0.5) & (np.abs(rays[..., 2]) < 0.3), 10 / np.maximum(rays[..., 0], 0.5), 0
    )
    points = unproject(wall)
    assert len(BASELINES["feng"].encode(points, 0.005)) < len(points) / 20
