"""Reliability: what is said beside what is true, of points that a pixel shows and that have a label."""

import numpy as np

from salpcc.schemas.labels import MOVABLE, OTHER
from salpcc.stages.evaluate.studies.reliability import calibration_error, reliability
from salpcc.stages.segment.network.projection import project
from salpcc.stages.segment.segmenter import Segmentation


def test_tenths_by_hand() -> None:
    azimuth = np.linspace(-1.5, 1.5, 60)
    points = np.stack([10 * np.cos(azimuth), 10 * np.sin(azimuth), np.zeros(60)], 1).astype(np.float32)
    image = project(np.concatenate([points, 1.01 * points[:1]]), np.zeros(61, np.float32))  # one is hidden
    groups = np.zeros((3, *image.index.shape), np.float32)
    low = image.index < 40
    groups[MOVABLE] = np.where(low, 0.25, 1.25) * (image.index >= 0)  # free space may add to a whole
    groups[OTHER] = 1 - groups[MOVABLE]
    movable = np.arange(61) % 4 == 0
    known = np.arange(61) != 8
    sums = reliability(Segmentation(image, groups, groups.astype(np.uint8)), known, movable)
    assert sums[2].tolist() == [39 * 0.25, 9.0, 39.0] and sums[9].tolist() == [20.0, 5.0, 20.0]
    assert sums.sum() == sums[[2, 9]].sum()
    assert abs(calibration_error(sums) - (0.75 + 15) / 59) < 1e-12
    assert calibration_error(np.zeros((10, 3))) == 0.0
