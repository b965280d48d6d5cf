"""What codes the levels and intensities of a GOP: adaptive bits (``fast``) or the learned networks.

Both have the same four methods, so a scan coder does not care which it was given.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from salpcc.schemas.errors import ArchiveError
from salpcc.schemas.prediction import Prediction
from salpcc.schemas.sweep import Sweep
from salpcc.stages.entropy.buffer import run_encoder
from salpcc.stages.entropy.intervals import encode_intervals
from salpcc.stages.entropy.range_coder import new_bits
from salpcc.stages.lattice.sensor_model import SensorModel
from salpcc.stages.predict.learned import intensity_model, range_model
from salpcc.stages.predict.learned.previous_sweep import WarpedSweep, warp
from salpcc.stages.predict.learned.shipped import EFFORTS, LearnedModels, load_models
from salpcc.stages.predict.static.coder import (
    decode_intensities,
    decode_levels,
    encode_intensities,
    encode_levels,
)
from salpcc.stages.predict.static.count_tables import StaticTables, shipped
from salpcc.stages.residual_code import class_coder
from salpcc.stages.residual_code.sensor import correction_coder, layer_mask_coder, mask_coder

Bytes = NDArray[np.uint8]
Starts = NDArray[np.int64]
Ticks = NDArray[np.int32]
Before = WarpedSweep | None


class ValueModels(Protocol):
    """Codes range levels and intensities; decoders tell whether the data made sense."""

    @property
    def weights(self) -> bytes: ...

    def encode_levels(self, sweep: Sweep, predicted: Prediction) -> bytes: ...
    def decode_levels(
        self, starts: Starts, tick: Ticks, step: int, before: Before, data: Bytes
    ) -> tuple[Ticks, bool]: ...
    def encode_intensity(self, values: Bytes, predicted: Prediction) -> bytes: ...
    def decode_intensity(
        self, starts: Starts, tick: Ticks, level: Ticks, step: int, before: Before, data: Bytes
    ) -> tuple[Bytes, bool]: ...


@dataclass(frozen=True)
class StaticModels:
    """Effort ``fast``: running means, and distributions from shipped tables."""

    sensor: SensorModel
    tables: StaticTables = field(default_factory=shipped)

    @property
    def weights(self) -> bytes:
        return bytes.fromhex(self.tables.digest)[:8]

    def encode_levels(self, sweep: Sweep, predicted: Prediction) -> bytes:
        assert predicted.residual is not None and predicted.level_context is not None
        return encode_levels(predicted.level_context, predicted.residual, sweep.step, self.tables)

    def decode_levels(
        self, starts: Starts, tick: Ticks, step: int, before: Before, data: Bytes
    ) -> tuple[Ticks, bool]:
        return decode_levels(starts, tick, step, self.sensor, self.tables, data)

    def encode_intensity(self, values: Bytes, predicted: Prediction) -> bytes:
        assert predicted.intensity_context is not None
        return encode_intensities(predicted.intensity_context, values, self.tables)

    def decode_intensity(
        self, starts: Starts, tick: Ticks, level: Ticks, step: int, before: Before, data: Bytes
    ) -> tuple[Bytes, bool]:
        return decode_intensities(starts, tick, level, self.tables, data)


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
        return levels + run_encoder(lambda out: encode_intervals(intervals, out), len(intervals))

    def decode_levels(
        self, starts: Starts, tick: Ticks, step: int, before: Before, data: Bytes
    ) -> tuple[Ticks, bool]:
        return range_model.decode_ranges(starts, tick, step, self.sensor, self.learned.ranges, data, before)

    def encode_intensity(self, values: Bytes, predicted: Prediction) -> bytes:
        intervals = predicted.intensity_interval
        assert intervals is not None
        return run_encoder(lambda out: encode_intervals(intervals, out), len(intervals))

    def decode_intensity(
        self, starts: Starts, tick: Ticks, level: Ticks, step: int, before: Before, data: Bytes
    ) -> tuple[Bytes, bool]:
        return intensity_model.decode_intensity(
            starts, tick, level, step, self.sensor, self.learned.intensity, data, before
        )


@dataclass(frozen=True)
class GopModels:
    """All that learns through a GOP, and the value models by effort, made when first needed."""

    sensor: SensorModel
    firing: NDArray[np.uint16] = field(default_factory=lambda: new_bits(mask_coder.FIRING_CONTEXTS))
    mask: NDArray[np.uint16] = field(default_factory=lambda: new_bits(mask_coder.RETURN_CONTEXTS))
    layer_firing: NDArray[np.uint16] = field(
        default_factory=lambda: new_bits(layer_mask_coder.FIRING_CONTEXTS)
    )
    layer_mask: NDArray[np.uint16] = field(default_factory=lambda: new_bits(layer_mask_coder.RETURN_CONTEXTS))
    millimetre: NDArray[np.uint16] = field(default_factory=lambda: new_bits(correction_coder.CONTEXTS))
    ulp: NDArray[np.uint16] = field(default_factory=lambda: new_bits(correction_coder.CONTEXTS))
    classes: NDArray[np.uint16] = field(default_factory=lambda: new_bits(class_coder.CONTEXTS))
    envelope: bytearray = field(default_factory=bytearray)  # of the recorded message before
    _values: dict[str, ValueModels] = field(default_factory=dict)
    _before: list[Sweep | None] = field(default_factory=lambda: [None])

    def values(self, effort: str) -> ValueModels:
        """Return the models of levels and intensities of an effort."""
        if effort not in self._values:
            self._values[effort] = (
                NetworkModels(self.sensor, load_models(effort))
                if effort in EFFORTS
                else StaticModels(self.sensor)
            )
        return self._values[effort]

    def warped(self, effort: str, motion: NDArray[np.float64] | None) -> WarpedSweep | None:
        """Return the sweep before as one with ``motion`` sees it; None for efforts that do not look back."""
        looks_back = effort in EFFORTS and load_models(effort).looks_back
        return warp(self._before[0], motion, self.sensor) if looks_back else None

    def remember(self, sweep: Sweep) -> None:
        """Keep a decoded sweep for the next one."""
        self._before[0] = sweep

    def known(self, effort: str, weights: bytes) -> ValueModels:
        """Return the models of an effort if they are the ones that ``weights`` names.

        Raises:
            ArchiveError: this installation ships other weights.
        """
        models = self.values(effort)
        if models.weights != weights:
            raise ArchiveError(
                f"payload was coded with the weights {weights.hex()} of effort {effort}; this version has "
                f"{models.weights.hex()}: decode it with the version that wrote it"
            )
        return models
