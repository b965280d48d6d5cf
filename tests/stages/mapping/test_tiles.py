"""Tiles: every point lies in one, blocks part all points, a box finds what it touches."""

from __future__ import annotations

import numpy as np

from salpcc.stages.mapping.tiles import Box, Tile, blocks_of


def points(seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-130, 90, (2000, 3))


def test_blocks_part_the_points() -> None:
    xyz = points()
    blocks = blocks_of(xyz, 50.0)
    whole = np.concatenate([part for _, part in blocks])
    assert np.array_equal(np.sort(whole), np.arange(len(xyz)))
    for tile, part in blocks:
        assert tile.holds(xyz[part], 50.0).all()
        assert tile in Box.around(xyz[part]).tiles(50.0)
    assert blocks_of(xyz[:0], 50.0) == []


def test_distance_is_that_to_the_square() -> None:
    tile = Tile(1, -1)
    assert tile.distance(np.array([60.0, -10.0, 99.0]), 50.0) == 0
    assert tile.distance(np.array([47.0, 4.0, 0.0]), 50.0) == 5.0
    assert tile.name == "x+001_y-001"
