"""What codes the levels and intensities of a scan: tables (``fast``) or the learned networks.

Both have the same methods, so a stream does not care which it was given. Decoders take both streams at once: tables decode one
while they wait for the other.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from salpcc.schemas.prediction import Prediction
from salpcc.schemas.sweep import Sweep
from salpcc.stages.entropy.intervals import encode_intervals
from salpcc.stages.lattice.sensor_model import SensorModel
from salpcc.stages.predict.learned import intensity_model, range_model
from salpcc.stages.predict.learned.previous_sweep import WarpedSweep
from salpcc.stages.predict.learned.shipped import LearnedModels, load_models
from salpcc.stages.predict.static.coder import decode, encode_intensities, encode_levels
from salpcc.stages.predict.static.count_tables import StaticTables, shipped

Bytes = NDArray[np.uint8]
Starts = NDArray[np.int64]
Ticks = NDArray[np.int32]
Before = WarpedSweep | None


class ValueModels(Protocol):
    """Codes range levels and intensities in hundredths; ``decode`` returns both (no intensities of None), and whether the data made sense."""

    @property
    def weights(self) -> bytes: ...

    def encode_levels(self, sweep: Sweep, predicted: Prediction) -> bytes: ...
    def encode_intensity(self, values: Bytes, predicted: Prediction) -> bytes: ...
    def decode(
        self, starts: Starts, tick: Ticks, step: int, before: Before, levels: Bytes, intensities: Bytes | None
    ) -> tuple[Ticks, Bytes, bool]: ...


@dataclass(frozen=True)
class StaticModels:
    """Effort ``fast``: running means, and distributions from shipped tables."""

    sensor: SensorModel
    tables: StaticTables = field(default_factory=shipped)

    @property
    def weights(self) -> bytes:
        return bytes.fromhex(self.tables.digest)[:8]

    def encode_levels(self, sweep: Sweep, predicted: Prediction) -> bytes:
        assert predicted.order is not None and predicted.residual is not None
        assert predicted.level_context is not None
        return encode_levels(
            predicted.order, predicted.level_context, predicted.residual, sweep.step, self.tables
        )

    def encode_intensity(self, values: Bytes, predicted: Prediction) -> bytes:
        assert predicted.order is not None and predicted.intensity_context is not None
        return encode_intensities(predicted.order, predicted.intensity_context, values, self.tables)

    def decode(
        self, starts: Starts, tick: Ticks, step: int, before: Before, levels: Bytes, intensities: Bytes | None
    ) -> tuple[Ticks, Bytes, bool]:
        return decode(starts, tick, step, self.sensor, self.tables, levels, intensities)


@dataclass(frozen=True)
class NetworkModels:
    """Efforts ``default`` and ``max``: learned distributions in exact arithmetic, nothing adaptive."""

    sensor: SensorModel
    learned: LearnedModels

    @property
    def weights(self) -> bytes:
        return bytes.fromhex(self.learned.digest)[:8]

    def encode_levels(self, sweep: Sweep, predicted: Prediction) -> bytes:
        intervals = predicted.range_interval
        assert intervals is not None
        levels = range_model.count_levels(sweep.count).to_bytes(range_model.HEADER, "little")
        return levels + encode_intervals(intervals)

    def encode_intensity(self, values: Bytes, predicted: Prediction) -> bytes:
        intervals = predicted.intensity_interval
        assert intervals is not None
        return encode_intervals(intervals)

    def decode(
        self, starts: Starts, tick: Ticks, step: int, before: Before, levels: Bytes, intensities: Bytes | None
    ) -> tuple[Ticks, Bytes, bool]:
        level, sound = range_model.decode_ranges(
            starts, tick, step, self.sensor, self.learned.ranges, levels, before
        )
        if intensities is None or not sound:
            return level, np.zeros(0, np.uint8), sound
        values, sound = intensity_model.decode_intensity(
            starts, tick, level, step, self.sensor, self.learned.intensity, intensities, before
        )
        return level, values, sound


def value_models(effort: str, sensor: SensorModel) -> ValueModels:
    """Return the models of levels and intensities of an effort."""
    return StaticModels(sensor) if effort == "fast" else NetworkModels(sensor, load_models(effort))
