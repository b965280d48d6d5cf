"""Predict every value of a sweep from those before it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from salpcc.schemas.prediction import Prediction
from salpcc.schemas.sweep import Sweep
from salpcc.stages.ingest.sensor_model import SensorModel
from salpcc.stages.predict.learned.intensity_model import predict_intensity
from salpcc.stages.predict.learned.models import load_models
from salpcc.stages.predict.learned.range_model import LEVEL_LIMIT, count_levels, predict_ranges
from salpcc.stages.predict.learned.sweep_walk import supports
from salpcc.stages.predict.neighbours import laser_table, predict_levels, ring_starts

INTENSITY_OF_LEVEL = (np.arange(101) / 100).astype(np.float32)


def intensity_levels(intensity: NDArray[np.float32]) -> NDArray[np.uint8] | None:
    """Return intensities ``(M,)`` in hundredths, or None where one is not float32 of n / 100."""
    with np.errstate(invalid="ignore"):
        levels = np.clip(np.nan_to_num(np.rint(intensity * 100.0)), 0, 100).astype(np.uint8)
    same = INTENSITY_OF_LEVEL[levels].view(np.int32) == np.ascontiguousarray(intensity).view(np.int32)
    return levels if bool(same.all()) else None


def effective_effort(sweep: Sweep, sensor: SensorModel, effort: str) -> str:
    """Return the effort that can code the sweep: the networks know the HDL-64E and ranges up to 262 m."""
    fits = supports(sensor) and count_levels(sweep.count) <= LEVEL_LIMIT and len(sweep.laser) > 0
    return effort if fits else "fast"


def predict(sweep: Sweep, sensor: SensorModel, effort: str) -> Prediction:
    """Predict each value of a sweep from those before it, as the decoder will."""
    starts = ring_starts(sweep.laser, sensor.n_lasers)
    effort = effective_effort(sweep, sensor, effort)
    if effort == "fast":
        table = laser_table(sensor)
        return Prediction(effort, *predict_levels(starts, sweep.tick, sweep.count, sweep.step, table))
    learned = load_models(effort)
    given = (starts, sweep.tick, sweep.count, sweep.step)
    ranges = predict_ranges(*given, sensor, learned.ranges)
    values = intensity_levels(sweep.intensity)
    intensity = None if values is None else predict_intensity(*given, values, sensor, learned.intensity)
    return Prediction(effort, range_interval=ranges, intensity_interval=intensity)
