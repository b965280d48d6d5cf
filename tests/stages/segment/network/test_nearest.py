"""Nearest points by a grid against a tree."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from salpcc.stages.segment.network.nearest import nearest, three_nearest


@pytest.mark.parametrize("spread", [0.01, 2.0, 30.0, 300.0], ids="{} m".format)
def test_against_a_tree(spread: float) -> None:
    """In one cell, in a few, in most, and beyond the edge of the grid."""
    rng = np.random.default_rng(0)
    points = (rng.standard_t(3, (2000, 3)) * [spread, spread, 2.0]).astype(np.float32)
    queries = np.concatenate([points[::7], rng.normal(0, spread, (300, 3)).astype(np.float32)])
    for k, found in (
        (3, nearest(points, queries, 3)),
        (3, three_nearest(points, queries)),
        (16, nearest(points, queries, 16)),
    ):
        wanted, there = cKDTree(points).query(queries, k=k)
        distance, places = found
        assert np.allclose(distance, wanted, rtol=1e-5, atol=1e-6)
        assert (places == there).mean() > 0.999  # but for what rounding makes equally near


def test_twins_and_as_few_points_as_asked() -> None:
    points = np.float32([[1, 2, 3], [1, 2, 3], [200, 0, 0]])
    queries = np.float32([[1, 2, 3], [-500, 0, 0]])
    for distance, places in (nearest(points, queries, 3), three_nearest(points, queries)):
        assert places.tolist() == [[0, 1, 2], [0, 1, 2]]
        assert np.allclose(distance[0], [0, 0, np.linalg.norm([199, 2, 3])])
