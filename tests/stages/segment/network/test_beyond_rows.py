"""What is steeper than the image takes the pixel of the same spot, or the ground's; what has none stays without."""

import numpy as np

from salpcc.stages.segment.back_projection import classes_of_points
from salpcc.stages.segment.network.projection import project
from salpcc.stages.segment.network.range_image import X

GROUND, CAR, WALL = 9, 1, 13


def _labelled(points: np.ndarray) -> np.ndarray:
    image = project(points, np.zeros(len(points), np.float32))
    x, height = image.planes[X], image.planes[5]
    classes = np.where(height < 0.2, GROUND, np.where(x < 6, CAR, WALL)).astype(np.uint8)
    classes[image.index < 0] = 0
    return classes_of_points(image, classes)


def _grid(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
    return np.stack(np.meshgrid(x, y, z, indexing="ij"), -1).reshape(-1, 3).astype(np.float32)


def test_ground_goes_on_and_things_go_up() -> None:
    spread = np.arange(-0.5, 0.5, 0.02)
    far_ground = _grid(np.arange(3.9, 30, 0.1), np.arange(-4, 4, 0.02), np.array([-1.75]))
    near_ground = _grid(np.array([1.5, 2.0]), spread, np.array([-1.75]))
    car = _grid(np.array([5.0]), spread, np.arange(-1.5, 0.1, 0.02))
    roof = _grid(np.array([5.0]), spread, np.array([0.6, 1.0]))
    wall = _grid(np.array([10.0]), spread, np.arange(-1.5, 0.3, 0.02))
    tree = _grid(np.array([5.0]), spread, np.array([4.0]))
    parts = [far_ground, near_ground, car, roof, wall, tree]
    classes = np.split(_labelled(np.concatenate(parts)), np.cumsum([len(p) for p in parts])[:-1])
    assert (classes[1] == GROUND).mean() > 0.9
    assert (classes[3] == CAR).mean() > 0.9
    assert (classes[4] == WALL).mean() > 0.9
    assert (classes[5] == 0).all()
