"""What all guesses of a cell's level say together: a mixture of logistic distributions.

Each guess of :mod:`salpcc.stages.predict.paper.grid_neighbours` is trusted by how far off it was close by.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.schemas.grid import COLUMNS
from salpcc.stages.entropy.mixing import logistic
from salpcc.stages.predict.paper.grid_neighbours import GUESSES


@njit(cache=True, error_model="numpy")
def mix_guesses(
    guesses: NDArray[np.float64],
    known: NDArray[np.float64],
    errors: NDArray[np.float32],
    running: NDArray[np.float64],
    row: int,
    column: int,
    up_row: int,
    before: NDArray[np.int64],
    n_before: int,
    mean: NDArray[np.float64],
    per: NDArray[np.float64],
    weight: NDArray[np.float64],
) -> tuple[float, float]:
    """Make the mixture at a cell; returns how far off it should be, and how far apart the guesses are."""
    total, blend = 0.0, 0.0
    for k in range(GUESSES):
        off, count = 0.9 * running[k], 0.9
        if n_before > 0:
            off += errors[row, before[0], k]
            count += 1.0
        if n_before > 1:
            off += 0.5 * errors[row, before[1], k]
            count += 0.5
        if up_row >= 0:
            for c in range(max(column - 1, 0), min(column + 3, COLUMNS)):
                if known[up_row, c] > 0.0:
                    share = 0.4 if c == column else 0.3
                    off += share * errors[up_row, c, k]
                    count += share
        off = off / count + 1.3
        trust = 1.0 / (off * off * off)
        total += trust
        blend += trust * guesses[k]
        weight[k] = trust
        per[k] = off
        mean[k] = 1.0 / guesses[k]
    middle = total / blend
    spread, apart = 0.0, 0.0
    for k in range(GUESSES):
        weight[k] = weight[k] / total
        spread += weight[k] * per[k]
        apart += weight[k] * abs(mean[k] - middle)
        weight[k] = weight[k] * 0.9
        per[k] = 2.6 / per[k]
    mean[GUESSES] = middle
    per[GUESSES] = 2.4 / (spread + 0.375 * apart)
    weight[GUESSES] = 0.1
    return spread, apart


@njit(cache=True, error_model="numpy")
def below(
    x: float, mean: NDArray[np.float64], per: NDArray[np.float64], weight: NDArray[np.float64]
) -> float:
    """Distribution function of the mixture."""
    total = 0.0
    for k in range(GUESSES + 1):
        total += weight[k] * logistic((x - mean[k]) * per[k])
    return total


@njit(cache=True, error_model="numpy")
def share_beyond(from_: float, to: float, cut: float) -> float:
    """Share of the mass between two values of the distribution function that lies beyond the cut."""
    whole = abs(to - from_)
    return abs(to - cut) / whole if whole > 1e-12 else 0.5
