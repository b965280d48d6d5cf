"""Frequencies from logits, and the intervals that follow from them, against the plain formula."""

from typing import Any

import numpy as np
import pytest
from numba import njit

from salpcc.stages.predict.learned.network import NEVER
from salpcc.stages.predict.learned.value_intervals import (
    BITS,
    LANES,
    OUTPUT_PLACES,
    ROOM,
    ROWS,
    VALUES,
    find_value,
    frequencies,
    value_start,
)

SHIFT = 17


@njit(error_model="numpy")
def run(sums: Any, shift: int, freq: Any) -> int:
    return frequencies(sums, 1, shift, freq, 2)


@njit(error_model="numpy")
def start(freq: Any, value: int) -> int:
    return value_start(freq, 2, value)


@njit(error_model="numpy")
def find(freq: Any, total: int, target: int) -> tuple[int, int]:
    return find_value(freq, 2, total, target)


def wanted(logits: np.ndarray) -> np.ndarray:
    """Frequencies by the formula, one after the other, in float32."""
    out = (logits / np.float32(1 << SHIFT)).astype(np.float32)
    p = np.maximum(np.float32(1) + (out - out.max()) * np.float32(1 / 16), np.float32(0))
    for _ in range(4):
        p = p * p
    return (p * np.float32(16384)).astype(np.int32) + 1


def in_lanes(logits: np.ndarray) -> np.ndarray:
    sums = np.full((2, ROWS * LANES), NEVER, np.int32)
    sums[1, list(OUTPUT_PLACES)] = logits
    return sums


@pytest.mark.parametrize("spread", [1e3, 1e5, 1e6, 2**24 - 1])
def test_frequencies_and_intervals_follow_the_formula(spread: float) -> None:
    rng = np.random.default_rng(int(spread))
    for _ in range(50):
        logits = np.rint(rng.uniform(-spread, spread, VALUES)).astype(np.int32)
        freq = np.zeros((3, ROOM), np.int32)
        total = run(in_lanes(logits), SHIFT, freq)
        plain = wanted(logits)
        np.testing.assert_array_equal(freq[2, list(OUTPUT_PLACES)], plain)
        assert total == plain.sum()
        starts = np.concatenate([[0], np.cumsum(plain.astype(np.int64))])
        for value in range(VALUES):
            assert start(freq, value) == starts[value]
        ends = (starts << BITS) // total
        for value in range(VALUES):
            for target in (ends[value], ends[value + 1] - 1):
                assert find(freq, total, target) == (value, starts[value])
