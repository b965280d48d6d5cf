"""Pictures: marks where things went, nothing of them afterwards."""

from __future__ import annotations

import io

import numpy as np
from PIL import Image

from salpcc.stages.mapping.build import DROPPED
from salpcc.stages.mapping.picture import HEIGHT, WIDTH, busiest, pictures, removed_picture
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


def test_what_was_removed_has_its_number_beside_it() -> None:
    rng = np.random.default_rng(0)
    xyz = np.concatenate([rng.uniform(-1, 1, (900, 3)), rng.uniform(-1, 1, (400, 3)) + [40, 20, 0]])
    voxels = Voxels.of_points(xyz, np.zeros(1300, np.float32), None)
    against, objects = np.full(1300, DROPPED, np.uint8), np.repeat(np.array([1, 2], np.uint32), [900, 400])

    def white(numbers: np.ndarray) -> tuple[int, int]:
        png = removed_picture(voxels, against, numbers)
        image = np.array(Image.open(io.BytesIO(png)).convert("RGB")).astype(int)
        lit = (image == 255).all(axis=2)
        return lit[:, : WIDTH // 2 + 80].sum(), lit[60 : HEIGHT // 2, WIDTH // 2 + 80 :].sum()

    none = white(np.zeros(0, np.uint32))
    both = white(objects)
    assert both[0] > none[0] and both[1] > none[1] == 0  # one in the middle, one up on the right
