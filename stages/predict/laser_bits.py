"""What the ranges of each laser cost: a laser that costs much more than those beside it, or returns nothing, may be sick.

By the predicted distributions, so nothing is coded for it; logarithms of floats, as no decoder needs them.
"""

from __future__ import annotations

from math import log2

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.schemas.prediction import Prediction
from salpcc.schemas.sweep import Sweep
from salpcc.stages.entropy import rans
from salpcc.stages.entropy.intervals import BITS
from salpcc.stages.predict.static.count_tables import shipped, table_of
from salpcc.stages.predict.static.tokens import ESCAPE, ESCAPED_BITS, shift_of, split


def laser_bits(sweep: Sweep, predicted: Prediction, n_lasers: int) -> NDArray[np.float64]:
    """Return the bits ``(n_lasers,)`` that the ranges of all returns of each laser take."""
    sums = np.zeros(n_lasers)
    if predicted.range_interval is not None:
        _of_intervals(sweep.laser, predicted.range_interval, sums)
    elif predicted.residual is not None and predicted.level_context is not None:
        start = shipped().level_symbols[table_of(sweep.step)].start
        _of_tokens(sweep.laser, predicted.level_context, predicted.residual, start, sums)
    return sums


@njit(cache=True)
def _of_intervals(laser: NDArray[np.uint8], interval: NDArray[np.uint32], sums: NDArray[np.float64]) -> None:
    for i in range(len(laser)):
        sums[laser[i]] += BITS - log2(interval[i, 1])


@njit(cache=True)
def _of_tokens(
    laser: NDArray[np.uint8],
    context: NDArray[np.uint8],
    residual: NDArray[np.int32],
    start: NDArray[np.uint16],
    sums: NDArray[np.float64],
) -> None:
    for i in range(len(laser)):
        row = np.int64(context[i])
        token, even, _ = split(np.int64(residual[i]), shift_of(row))
        width = 0
        if token < ESCAPE:
            width = int(start[row, token + 1]) - int(start[row, token])
        if width == 0:
            width, even = (1 << rans.BITS) - int(start[row, ESCAPE]), ESCAPED_BITS
        sums[laser[i]] += rans.BITS - log2(width) + even
