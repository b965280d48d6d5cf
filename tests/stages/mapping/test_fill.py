"""Filling: a small hole in flat ground closes with points on its plane; nothing else is invented."""

from __future__ import annotations

import numpy as np

from salpcc.stages.mapping.fill import fill_ground
from salpcc.stages.mapping.voxel import SYNTHETIC, Voxels

ROAD, BUILDING = 9, 13


def ground(hole: float, slope: float = 0.05, noise: float = 0.0) -> Voxels:
    """20 m x 20 m of road that rises along x, without a square of ``hole`` metres in the middle."""
    x, y = (v.ravel() for v in np.meshgrid(np.arange(-10, 10, 0.1), np.arange(-10, 10, 0.1)))
    there = np.maximum(np.abs(x), np.abs(y)) > hole / 2
    x, y = x[there], y[there]
    z = slope * x + noise * np.random.default_rng(0).normal(size=len(x))
    return Voxels.of_points(
        np.column_stack([x, y, z]), np.full(len(x), 0.3, np.float32), np.full(len(x), ROAD, np.uint8)
    )


def test_a_hole_closes_on_the_plane() -> None:
    filled = fill_ground(ground(3.0))
    assert abs(len(filled) * 0.25**2 - 9.0) < 2.0
    assert (filled.classes == SYNTHETIC).all() and not filled.count.any() and not filled.scans.any()
    assert np.abs(filled.xyz[:, :2]).max() <= 1.6
    np.testing.assert_allclose(filled.xyz[:, 2], 0.05 * filled.xyz[:, 0], atol=1e-6)


def test_large_rough_and_steep_ground_stays_open() -> None:
    assert not len(fill_ground(ground(6.0)))
    assert not len(fill_ground(ground(3.0, noise=0.2)))
    assert not len(fill_ground(ground(3.0, slope=0.6)))


def test_what_stands_in_a_hole_is_not_covered() -> None:
    voxels = ground(3.0)
    block = np.abs(np.random.default_rng(1).uniform(-1.5, 1.5, (4000, 3)))
    wall = Voxels.of_points(block, np.zeros(4000, np.float32), np.full(4000, BUILDING, np.uint8))
    filled = fill_ground(Voxels.together([voxels, wall]))
    inside = (filled.xyz[:, 0] > 0.25) & (filled.xyz[:, 1] > 0.25)
    assert not inside.any()


def test_no_ground_nothing_filled() -> None:
    assert not len(fill_ground(Voxels.together([])))
