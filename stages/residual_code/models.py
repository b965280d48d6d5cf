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
from salpcc.stages.ingest.sensor_model import SensorModel
from salpcc.stages.predict.learned import intensity_model, range_model
from salpcc.stages.predict.learned.models import EFFORTS, LearnedModels, load_models
from salpcc.stages.predict.learned.previous_sweep import WarpedSweep, warp
from salpcc.stages.predict.neighbours import laser_table
from salpcc.stages.residual_code import (
    class_coder,
    correction_coder,
    intensity_coder,
    level_coder,
    mask_coder,
)
from salpcc.stages.residual_code.interval_coder import encode_intervals
from salpcc.stages.residual_code.range_coder import new_bits

Bytes = NDArray[np.uint8]
Starts = NDArray[np.int64]
Ticks = NDArray[np.int32]
Before = WarpedSweep | None
NO_WEIGHTS = bytes(8)


class ValueModels(Protocol):
    """Codes range levels and intensities; encoders return bytes written (-1: no room), decoders success."""

    @property
    def weights(self) -> bytes: ...

    def encode_levels(self, sweep: Sweep, starts: Starts, predicted: Prediction, out: Bytes) -> int: ...
    def decode_levels(
        self, starts: Starts, tick: Ticks, step: int, before: Before, data: Bytes
    ) -> tuple[Ticks, bool]: ...
    def encode_intensity(
        self, sweep: Sweep, starts: Starts, values: Bytes, predicted: Prediction, out: Bytes
    ) -> int: ...
    def decode_intensity(
        self, starts: Starts, tick: Ticks, level: Ticks, step: int, before: Before, data: Bytes
    ) -> tuple[Bytes, bool]: ...


@dataclass(frozen=True)
class AdaptiveModels:
    """Effort ``fast``: adaptive bits around the neighbours' prediction, learning through a GOP."""

    sensor: SensorModel
    weights: bytes = NO_WEIGHTS
    levels: NDArray[np.uint16] = field(default_factory=lambda: new_bits(level_coder.CONTEXTS))
    recent: NDArray[np.uint16] = field(default_factory=lambda: new_bits(level_coder.CONTEXTS_BEFORE))
    intensity: NDArray[np.uint16] = field(default_factory=lambda: new_bits(intensity_coder.CONTEXTS))
    by_laser: NDArray[np.uint16] = field(default_factory=lambda: new_bits(intensity_coder.LASER_CONTEXTS))

    def encode_levels(self, sweep: Sweep, starts: Starts, predicted: Prediction, out: Bytes) -> int:
        assert predicted.level is not None and predicted.spread is not None
        return int(
            level_coder.encode_levels(
                starts, sweep.count, predicted.level, predicted.spread, self.levels, self.recent, out
            )
        )

    def decode_levels(
        self, starts: Starts, tick: Ticks, step: int, before: Before, data: Bytes
    ) -> tuple[Ticks, bool]:
        level, sound = level_coder.decode_levels(
            starts, tick, step, laser_table(self.sensor), self.levels, self.recent, data
        )
        return level, bool(sound)

    def encode_intensity(
        self, sweep: Sweep, starts: Starts, values: Bytes, predicted: Prediction, out: Bytes
    ) -> int:
        return int(
            intensity_coder.encode_intensity(
                starts, sweep.tick, sweep.count, values, self.intensity, self.by_laser, out
            )
        )

    def decode_intensity(
        self, starts: Starts, tick: Ticks, level: Ticks, step: int, before: Before, data: Bytes
    ) -> tuple[Bytes, bool]:
        values, sound = intensity_coder.decode_intensity(
            starts, tick, level, self.intensity, self.by_laser, data
        )
        return values, bool(sound)


@dataclass(frozen=True)
class NetworkModels:
    """Efforts ``default`` and ``max``: learned distributions in exact arithmetic, nothing adaptive."""

    sensor: SensorModel
    learned: LearnedModels

    @property
    def weights(self) -> bytes:
        return bytes.fromhex(self.learned.digest)[:8]

    def encode_levels(self, sweep: Sweep, starts: Starts, predicted: Prediction, out: Bytes) -> int:
        assert predicted.range_interval is not None
        header = range_model.HEADER
        out[:header] = np.frombuffer(
            range_model.count_levels(sweep.count).to_bytes(header, "little"), np.uint8
        )
        written = int(encode_intervals(predicted.range_interval, out[header:]))
        return written + header if written >= 0 else -1

    def decode_levels(
        self, starts: Starts, tick: Ticks, step: int, before: Before, data: Bytes
    ) -> tuple[Ticks, bool]:
        return range_model.decode_ranges(starts, tick, step, self.sensor, self.learned.ranges, data, before)

    def encode_intensity(
        self, sweep: Sweep, starts: Starts, values: Bytes, predicted: Prediction, out: Bytes
    ) -> int:
        assert predicted.intensity_interval is not None
        return int(encode_intervals(predicted.intensity_interval, out))

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
                else AdaptiveModels(self.sensor)
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
