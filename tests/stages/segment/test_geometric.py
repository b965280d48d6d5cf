"""The geometric split finds roads on real scans and survives odd clouds."""

import numpy as np

from salpcc.schemas.labels import GROUND, GROUP_OF_CLASS, classes_of_labels
from salpcc.stages.segment.geometric import GROUND_CLASS, split_ground


def test_a_floor_with_a_box_on_it() -> None:
    rng = np.random.default_rng(0)
    floor = np.column_stack([rng.uniform(-20, 20, (4000, 2)), rng.normal(-1.73, 0.01, 4000)])
    box = np.column_stack([rng.uniform(5, 7, (500, 2)), rng.uniform(-1.4, 0, 500)])
    ground = split_ground(np.concatenate([floor, box]).astype(np.float32)) == GROUND_CLASS
    assert ground[:4000].mean() > 0.99
    assert ground[4000:].mean() < 0.05


def test_odd_clouds() -> None:
    assert len(split_ground(np.zeros((0, 3), np.float32))) == 0
    odd = np.array([[np.nan, 0, 0], [np.inf, 0, 0], [1e30, 1e30, -1e30], [0, 0, 0]], np.float32)
    assert (split_ground(odd) != GROUND_CLASS).all()


def test_real_scans(real_data) -> None:
    scores = []
    for file in sorted(real_data.glob("semantickitti/sequences/*/velodyne/000000.bin")):
        points = np.fromfile(file, np.float32).reshape(-1, 4)[:, :3]
        labels = np.fromfile(file.parents[1] / "labels" / "000000.label", np.uint32)
        truth = GROUP_OF_CLASS[classes_of_labels(labels)] == GROUND
        found = split_ground(points) == GROUND_CLASS
        scores.append((truth & found).sum() / truth.sum())
    assert np.mean(scores) > 0.85  # of the labelled ground is found; terrain counts as other in the labels
