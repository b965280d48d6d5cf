"""What the scans of a GOP share while they are coded one after the other; fresh at its first scan."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from salpcc.schemas.errors import ArchiveError
from salpcc.schemas.sweep import Sweep
from salpcc.stages.entropy.range_coder import new_bits
from salpcc.stages.lattice.sensor_model import SensorModel
from salpcc.stages.lattice.timed_motion import TimedMotion
from salpcc.stages.lists.learned.learned_lists import LearnedLists
from salpcc.stages.lists.rays.ray_coder import Layout
from salpcc.stages.lists.timed.fit_turning import Fitted
from salpcc.stages.predict.learned.previous_sweep import WarpedSweep, warp
from salpcc.stages.predict.learned.shipped import EFFORTS, load_models
from salpcc.stages.residual_code import class_coder
from salpcc.stages.residual_code.message.field_modes import FieldModes
from salpcc.stages.residual_code.sensor import correction_coder, layer_mask_coder, mask_coder
from salpcc.stages.residual_code.sensor.value_models import ValueModels, value_models


@dataclass
class GopState:
    """All that learns through a GOP, what was decoded last, and the value models by effort, made when first needed.

    Each layer of a group has its own.

    Args:
        learns: a writer of an effort above ``fast``; a reader is told by what it reads.
    """

    sensor: SensorModel
    learns: bool = False
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
    fields: FieldModes = field(init=False)  # of recorded messages
    lists: LearnedLists = field(default_factory=LearnedLists)  # of points
    before: Sweep | None = None  # the scan decoded last
    # An encoder's business only: layouts of lists of points by topic, with the bytes a point that they took; rays that turn, and motions by time; and
    # scans in a row whose points did not follow from their times.
    layouts: dict[str, tuple[Layout, float]] = field(default_factory=dict)
    turning: dict[str, Fitted] = field(default_factory=dict)
    moved_by: dict[str, TimedMotion] = field(default_factory=dict)
    timeless: int = 0
    _values: dict[str, ValueModels] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.fields = FieldModes(self.learns)

    def values(self, effort: str) -> ValueModels:
        """Return the models of levels and intensities of an effort."""
        if effort not in self._values:
            self._values[effort] = value_models(effort, self.sensor)
        return self._values[effort]

    def warped(self, effort: str, motion: NDArray[np.float64] | None) -> WarpedSweep | None:
        """Return the sweep before as one with ``motion`` sees it; None for efforts that do not look back."""
        looks_back = effort in EFFORTS and load_models(effort).looks_back
        return warp(self.before, motion, self.sensor) if looks_back else None

    def known(self, effort: str, weights: bytes) -> ValueModels:
        """Return the models of an effort, which ``weights`` must name.

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
