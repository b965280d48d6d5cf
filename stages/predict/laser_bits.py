"""What the ranges of each laser cost: a laser that costs much more than those beside it, or returns nothing, may be sick.

By the predicted distributions, so nothing is coded for it; logarithms of floats, as no decoder needs them.
"""

from __future__ import annotations

from functools import cache
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
    if predicted.range_interval is not None and predicted.order is not None:
        _of_intervals(predicted.order, predicted.range_interval, sums)
    elif predicted.residual is not None and predicted.level_context is not None:
        costs = _token_costs(table_of(sweep.step))
        _of_tokens(sweep.laser, predicted.level_context, predicted.residual, costs, sums)
    return sums


@cache
def _token_costs(table: int) -> NDArray[np.float64]:
    """Bits ``(C, TOKENS)`` of each token of residuals, even ones apart; infinite where it has to be escaped."""
    frequency = shipped().levels[table]
    return np.where(frequency > 0, rans.BITS - np.log2(np.maximum(frequency, 1)), np.inf)


@njit(cache=True)
def _of_intervals(laser: NDArray[np.uint8], interval: NDArray[np.uint32], sums: NDArray[np.float64]) -> None:
    for i in range(len(laser)):
        sums[laser[i]] += BITS - log2(interval[i, 1])


@njit(cache=True)
def _of_tokens(
    laser: NDArray[np.uint8],
    context: NDArray[np.uint8],
    residual: NDArray[np.int32],
    costs: NDArray[np.float64],
    sums: NDArray[np.float64],
) -> None:
    for i in range(len(laser)):
        row = np.int64(context[i])
        token, even, _ = split(np.int64(residual[i]), shift_of(row))
        if token >= ESCAPE or costs[row, token] == np.inf:
            token, even = ESCAPE, ESCAPED_BITS
        sums[laser[i]] += costs[row, token] + even
