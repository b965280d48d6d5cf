"""Reliability diagram: of the pixels that are said to be movable with some probability, how many are."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from salpcc.schemas.labels import MOVABLE
from salpcc.stages.segment.segmenter import Segmentation

BINS = 10
SAID, TRUE, PIXELS = range(3)


def reliability(
    found: Segmentation, known: NDArray[np.bool_], movable: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """Sum up, per tenth of probability, what is said and what is true of the pixels of a scan: ``(10, 3)``.

    Args:
        found: what is said.
        known, movable: ``(N,)`` of the scan's points, whether it is known what they are, and whether that is movable.

    Returns:
        Columns: sum of the probabilities, number of movable pixels, number of pixels.
    """
    seen = found.image.index >= 0
    shown = found.image.index[seen]
    said = found.groups[MOVABLE, seen].clip(0.0, 1.0)[known[shown]].astype(np.float64)
    true = movable[shown][known[shown]]
    tenth = np.minimum((said * BINS).astype(np.int64), BINS - 1)
    sums = [np.bincount(tenth, weights, BINS) for weights in (said, true, np.ones(len(said)))]
    return np.stack(sums, 1)


def calibration_error(sums: NDArray[np.float64]) -> float:
    """Return the expected calibration error of sums ``(10, 3)``: how far what is said is off, mean over the pixels."""
    return float(np.abs(sums[:, SAID] - sums[:, TRUE]).sum() / max(sums[:, PIXELS].sum(), 1.0))
