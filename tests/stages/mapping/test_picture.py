"""Pictures: marks where things went, nothing of them afterwards."""

from __future__ import annotations

import io

import numpy as np
from PIL import Image

from salpcc.stages.mapping.build import DROPPED
from salpcc.stages.mapping.picture import HEIGHT, WIDTH, busiest, pictures
from salpcc.stages.mapping.voxel import Voxels


def test_what_was_taken_out_is_red_before_and_gone_after() -> None:
    rng = np.random.default_rng(0)
    ground = np.column_stack([rng.uniform(-50, 50, (40000, 2)), np.full(40000, -1.7)])
    car = rng.uniform([20, 3, -1.5], [24, 5, 0], (3000, 3))
    voxels = Voxels.of_points(np.concatenate([ground, car]), np.zeros(43000, np.float32), None)
    against = np.repeat(np.array([0, DROPPED], np.uint8), [40000, 3000])
    poses = np.array([np.eye(4), np.eye(4)])
    poses[0, 0, 3] = -200.0
    place = busiest(poses, voxels.xyz, against)
    assert place.pose[0, 3] == 0.0
    drawn = pictures(voxels, against, place)
    assert sorted(drawn) == ["above_after", "above_before", "perspective_after", "perspective_before"]
    for name, png in drawn.items():
        image = np.array(Image.open(io.BytesIO(png)).convert("RGB")).astype(int)
        assert image.shape == (HEIGHT, WIDTH, 3)
        red = (image[:, :, 0] > 200) & (image[:, :, 1] < 80)
        assert red.any() == name.endswith("before")
        if name == "above_before":  # ahead is right, left is up
            rows, columns = np.nonzero(red)
            assert columns.min() > WIDTH / 2 and rows.max() < HEIGHT / 2
