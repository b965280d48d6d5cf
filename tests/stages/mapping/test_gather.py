"""What of a scan may move is known by its class, or by the layer that it is in."""

from __future__ import annotations

import numpy as np

from salpcc.schemas.scan import Scan
from salpcc.stages.mapping.config import MapConfig
from salpcc.stages.mapping.gather import gather, standing


def test_a_movable_layer_without_classes_is_movable() -> None:
    rng = np.random.default_rng(0)
    ground = np.column_stack([rng.uniform(-20, 20, (4000, 2)), np.full(4000, -1.7)])
    thing = rng.uniform([8, 2, -1.5], [10, 4, 0], (500, 3))
    points = np.concatenate([ground, thing]).astype(np.float32)
    movable = np.repeat([False, True], [4000, 500])
    scan = Scan("0", points, np.zeros(4500, np.float32), movable=movable)
    config = MapConfig.model_validate({"voxel": 0.2, "min_range": 0})
    voxels = gather([scan], np.eye(4)[None], np.zeros((1, 6)), config).voxels
    assert voxels.count[voxels.movable].sum() == 500 and voxels.count[~voxels.movable].sum() == 4000
    np.testing.assert_array_equal(standing(scan, config), ~movable)
