"""The prediction: what is known of a sweep's values before they are coded."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class Prediction:
    """Predictions of a sweep's M returns; which there are depends on the effort.

    Attributes:
        effort: the effort that coding will take; ``fast`` where no network knows the sensor.
        residual, level_context: effort ``fast``: level minus predicted level int32, and its context uint8, ``(M,)``.
        intensity_context: effort ``fast``: uint16 ``(M,)``, None for intensities that are no hundredths.
        order: in the order in which ranges are coded, uint8 ``(M,)``: of each return the ring, effort ``fast``, or the laser.
        range_interval, intensity_interval: the learned efforts: uint32 ``(M, 2)``, start and width of the
            interval that the predicted distribution gives to the actual value, in the order of coding. The latter is None for
            intensities that are no hundredths.
    """

    effort: str
    residual: NDArray[np.int32] | None = None
    level_context: NDArray[np.uint8] | None = None
    intensity_context: NDArray[np.uint16] | None = None
    order: NDArray[np.uint8] | None = None
    range_interval: NDArray[np.uint32] | None = None
    intensity_interval: NDArray[np.uint32] | None = None
