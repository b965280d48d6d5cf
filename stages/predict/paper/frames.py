"""Predict the frames of a GOP of range images from those before them, in encoder and decoder alike."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from salpcc.schemas.grid import COLUMNS, ROWS, GridPrediction, GridSweep
from salpcc.stages.ingest.paper_grid import ELEVATION_UNIT, LEVEL_LIMIT, directions
from salpcc.stages.predict.paper.motion import UNITS, find_motion

if TYPE_CHECKING:
    from salpcc.stages.predict.paper.st_lstm import Memory

_MM = 0.001


def network_weights() -> bytes:
    """Return the 8 bytes that name the prediction network's weights."""
    from salpcc.stages.predict.paper.st_lstm import load_model

    return load_model().digest[:8]


class FramePredictor:
    """Runs the prediction network (section V-B) through a GOP, one frame after the other."""

    def __init__(self, elevation: NDArray[np.int16], accuracy: float) -> None:
        self._elevation = elevation.astype(np.float64) * ELEVATION_UNIT
        self._accuracy = accuracy
        self._memory: Memory | None = None
        self._last: NDArray[np.int32] | None = None

    def predict(self, motion: NDArray[np.int32] | None) -> GridPrediction:
        """Predict the next frame; ``motion`` ``(6,)`` from the last one to it, in UNITS.

        None is for the first frame, and where no motion is known: then the network starts afresh.
        """
        if motion is None or self._last is None:
            self._memory = None
            return GridPrediction()
        from salpcc.stages.predict.paper.st_lstm import (
            predict_frame,  # torch: the sensor profile goes without
        )

        found, self._memory = predict_frame(self._memory, self._last, motion * UNITS, self._elevation)
        level = np.floor(found.ranges * _MM / self._accuracy + 0.5)
        level[(found.ranges <= 0) | (level >= LEVEL_LIMIT)] = 0
        return GridPrediction(motion, level.astype(np.int32), found.spread)

    def learn(self, level: NDArray[np.int32]) -> None:
        """Take the levels ``(64, 2000)`` of the frame that was coded."""
        self._last = np.floor(level * self._accuracy / _MM + 0.5).astype(np.int32)


def predict_gop(sweeps: list[GridSweep]) -> list[GridPrediction]:
    """Predict every sweep of a GOP, as the decoder will once it is told the motions found here."""
    if not sweeps:
        return []
    predictor = FramePredictor(sweeps[0].elevation, sweeps[0].accuracy)
    beams = directions(sweeps[0].elevation)
    predictions: list[GridPrediction] = []
    before = None
    for sweep in sweeps:
        points = beams * (sweep.level.reshape(ROWS * COLUMNS, 1) * sweep.accuracy)
        motion = None if before is None else find_motion(before, points, _guess(sweep, predictions[-1]))
        predictions.append(predictor.predict(motion))
        predictor.learn(sweep.level)
        before = points
    return predictions


def _guess(sweep: GridSweep, last: GridPrediction) -> NDArray[np.float64] | None:
    """The motion that ingest found for the scan itself, else that of the frame before."""
    if sweep.motion is not None:
        return sweep.motion
    return None if last.motion is None else last.motion * UNITS
