"""Intervals of intensities from a network's logits, and the value that a point of the interval belongs to."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

BITS = 24
VALUES = 101  # intensities 0 to 100
OUTPUTS = 104  # VALUES, padded

_ONE, _ZERO = np.float32(1.0), np.float32(0.0)
_FINE = np.float32(16384.0)
_LINK = np.float32(1.0 / 16.0)


@njit(cache=True, error_model="numpy")
def frequencies(out: NDArray[np.float32], freq: NDArray[np.int32]) -> None:
    """Turn logits into integer frequencies, each at least 1: (1 + l / 16)^16 stands in for exp(l)."""
    largest = out[0]
    for v in range(1, VALUES):
        largest = max(largest, out[v])
    for v in range(VALUES):
        p = max(_ONE + (out[v] - largest) * _LINK, _ZERO)
        p = p * p
        p = p * p
        p = p * p
        p = p * p
        freq[v] = np.int32(p * _FINE) + np.int32(1)


@njit(cache=True, error_model="numpy")
def value_start(freq: NDArray[np.int32], value: int) -> int:
    """Return how many counts stand before a value."""
    cum = 0
    for v in range(value):
        cum += freq[v]
    return cum


@njit(cache=True, error_model="numpy")
def find_value(freq: NDArray[np.int32], total: int, target: int) -> tuple[int, int]:
    """Return the last value whose scaled start is not after the target, and the counts before it."""
    wanted = (((target + 1) * total + (1 << BITS) - 1) >> BITS) - 1
    cum, value = 0, 0
    while value < VALUES - 1 and cum + freq[value] <= wanted:
        cum += freq[value]
        value += 1
    return value, cum
