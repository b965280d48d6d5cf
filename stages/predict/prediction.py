"""What is known of a sweep's levels before they are coded."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from salpcc.schemas.sweep import Sweep
from salpcc.stages.ingest.sensor_model import SensorModel
from salpcc.stages.predict.neighbours import laser_table, predict_levels, ring_starts


@dataclass(frozen=True, eq=False)
class Prediction:
    """Predicted level and spread bucket per return, ``(M,)``; None where networks predict while coding."""

    level: NDArray[np.int32] | None = None
    spread: NDArray[np.uint8] | None = None


def predict(sweep: Sweep, sensor: SensorModel, effort: str) -> Prediction:
    """Predict a sweep's levels, each from the returns before it."""
    if effort != "fast":
        return Prediction()
    starts = ring_starts(sweep.laser, sensor.n_lasers)
    return Prediction(*predict_levels(starts, sweep.tick, sweep.count, sweep.step, laser_table(sensor)))
