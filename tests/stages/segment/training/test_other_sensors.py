"""Crops of other sensors show points that were there, under their own labels, and at times without intensities."""

import numpy as np
import pytest

from salpcc.stages.segment.network.projection import project
from salpcc.stages.segment.network.range_image import INTENSITY, RANGE
from salpcc.stages.segment.training.crops import Crop
from salpcc.stages.segment.training.other_sensors import as_other_sensor


@pytest.fixture(scope="module")
def crop(make_scan) -> Crop:
    scan = make_scan(stride=1, motion=None)
    image = project(scan.points, scan.intensity)
    classes = np.where(image.index >= 0, scan.classes[image.index], np.uint8(0))
    return Crop(image.planes[:, :, :256].copy(), classes[:, :256].copy(), 0)


def test_labels_follow_what_is_shown(crop: Crop) -> None:
    rng = np.random.default_rng(0)
    whole = (crop.planes[RANGE] > 0).sum()
    for _ in range(20):
        seen = as_other_sensor(crop, rng)
        shown = seen.planes[RANGE] > 0
        assert 0.5 * whole < shown.sum()
        assert (seen.classes[~shown] == 0).all()
        assert (seen.classes[shown] == crop.classes[shown]).mean() > 0.8
        assert (np.abs(seen.planes[RANGE] - crop.planes[RANGE])[shown] < 1.0).mean() > 0.7


def test_some_are_without_intensities_and_the_crop_itself_stays(crop: Crop) -> None:
    rng, before = np.random.default_rng(1), crop.planes.copy()
    unlit = [not as_other_sensor(crop, rng).planes[INTENSITY].any() for _ in range(40)]
    assert 5 < sum(unlit) < 30
    assert np.array_equal(crop.planes, before)
