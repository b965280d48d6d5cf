"""Crops as sensors with fewer rings, slower firings or no intensities would have seen them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from salpcc.stages.segment.network.between_rings import fill_between_rings, has_gaps
from salpcc.stages.segment.network.range_image import INTENSITY, RANGE
from salpcc.stages.segment.training.crops import Crop

_RINGS = (1, 2, 3, 4)  # rows from one ring to the next
_FIRINGS = (1, 2)  # columns from one firing to the next
_UNLIT = 0.4  # share of these crops that have no intensities


def as_other_sensor(crop: Crop, rng: np.random.Generator) -> Crop:
    """Take rings, firings or intensities from a crop at random, and fill it as clouds of other sensors are filled."""
    planes = crop.planes.copy()
    if rng.random() < _UNLIT:
        planes[INTENSITY] = 0.0
    rings, firings = int(rng.choice(_RINGS)), int(rng.choice(_FIRINGS))
    _, rows, columns = planes.shape
    kept = np.zeros((rows, columns), np.bool_)
    kept[rng.integers(rings) :: rings, rng.integers(firings) :: firings] = True
    if rings > 1 and rng.random() < 0.5:  # closer together around the horizon, as most sensors have them
        middle = int(rng.integers(4, 24))
        kept[middle : middle + 8, rng.integers(firings) :: firings] = True
    kept &= planes[RANGE] > 0
    planes[:, ~kept] = 0.0
    shown = np.where(kept, np.arange(rows * columns, dtype=np.int32).reshape(rows, columns), np.int32(-1))
    if has_gaps(shown):
        fill_between_rings(planes, shown)
    return replace(
        crop, planes=planes, classes=np.where(shown >= 0, crop.classes.ravel()[shown], np.uint8(0))
    )
