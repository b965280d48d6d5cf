"""Objects: what a network missed of a car goes with it; the ground below and the wall behind stay."""

from __future__ import annotations

import numpy as np

from salpcc.stages.mapping.objects import rest_of_objects
from salpcc.stages.mapping.voxel import Voxels, fuse

CAR, ROAD, FENCE, BUILDING = 1, 9, 14, 13


def test_the_rest_of_a_car_goes_with_it() -> None:
    rng = np.random.default_rng(0)
    car = rng.uniform([0, 0, 0.3], [4, 2, 1.5], (20000, 3))
    ground = rng.uniform([-3, -3, -0.02], [7, 5, 0.02], (20000, 3))
    wall = rng.uniform([-3, 4, 0], [7, 4.1, 3], (20000, 3))
    seen = rng.random(len(car)) < 0.9
    classes = np.concatenate(
        [np.where(seen, CAR, FENCE), np.full(len(ground), ROAD), np.full(len(wall), BUILDING)]
    ).astype(np.uint8)
    xyz = np.concatenate([car, ground, wall])
    voxels = fuse(Voxels.of_points(xyz, np.zeros(len(xyz), np.float32), classes), 0.1)
    rest = rest_of_objects(voxels)
    assert rest[voxels.classes == FENCE].all()
    assert not rest[voxels.movable].any() and not rest[np.isin(voxels.classes, (ROAD, BUILDING))].any()
    assert not rest_of_objects(voxels[~voxels.movable]).any()
