"""Predict every value of a sweep from those before it."""

from __future__ import annotations

from collections.abc import Iterable

from salpcc.schemas.prediction import Prediction
from salpcc.schemas.sweep import Sweep
from salpcc.stages.lattice.sensor_model import SensorModel
from salpcc.stages.predict.hundredths import INTENSITY_OF_LEVEL, intensity_levels
from salpcc.stages.predict.learned.intensity_model import predict_intensity
from salpcc.stages.predict.learned.previous_sweep import warp
from salpcc.stages.predict.learned.range_model import LEVEL_LIMIT, count_levels, predict_ranges
from salpcc.stages.predict.learned.shipped import load_models
from salpcc.stages.predict.ring_starts import ring_starts
from salpcc.stages.predict.static.coder import contexts
from salpcc.stages.predict.sweep_walk import supports

__all__ = ["INTENSITY_OF_LEVEL", "effective_effort", "intensity_levels", "predict", "predict_sweeps"]


def effective_effort(sweep: Sweep, sensor: SensorModel, effort: str) -> str:
    """Return the effort that can code the sweep: the networks know the HDL-64E and ranges up to 262 m."""
    fits = supports(sensor) and count_levels(sweep.count) <= LEVEL_LIMIT and len(sweep.laser) > 0
    return effort if fits else "fast"


def predict(sweep: Sweep, sensor: SensorModel, effort: str, before: Sweep | None = None) -> Prediction:
    """Predict each value of a sweep from those before it, as the decoder will.

    ``before`` is the sweep before in the GOP; effort ``max`` alone looks at it.
    """
    starts = ring_starts(sweep.laser, sensor.n_lasers)
    effort = effective_effort(sweep, sensor, effort)
    given = (starts, sweep.tick, sweep.count, sweep.step)
    values = intensity_levels(sweep.intensity)
    if effort == "fast":
        found = contexts(*given, sensor) if values is None else contexts(*given, sensor, values)
        of_values = None if values is None else found.of_values
        return Prediction(effort, found.residual, found.of_levels, of_values, found.order)
    learned = load_models(effort)
    warped = warp(before, sweep.motion, sensor) if learned.looks_back else None
    ranges, order = predict_ranges(*given, sensor, learned.ranges, warped)
    intensity = (
        None if values is None else predict_intensity(*given, values, sensor, learned.intensity, warped)
    )
    return Prediction(effort, order=order, range_interval=ranges, intensity_interval=intensity)


def predict_sweeps(sweeps: Iterable[Sweep], sensor: SensorModel, effort: str) -> list[Prediction]:
    """Predict the sweeps of one GOP, each from itself and the one before."""
    before = None
    predictions = []
    for sweep in sweeps:
        predictions.append(predict(sweep, sensor, effort, before))
        before = sweep
    return predictions
