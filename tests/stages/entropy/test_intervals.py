"""Intervals come back in any number; what is not an encoder's is told."""

import numpy as np
import pytest
from numba import njit

from salpcc.stages.entropy.intervals import BITS, STATES, begin, encode_intervals, ended, take, target


@njit
def _decode(state: np.ndarray, words: np.ndarray, intervals: np.ndarray, ahead: int) -> bool:
    """Take all intervals, looking ``ahead`` of the one to take; whether each held its target."""
    held = True
    for n in range(len(intervals)):
        for m in range(n, min(n + ahead, len(intervals))):
            low, width = np.int64(intervals[m, 0]), np.int64(intervals[m, 1])
            held &= low <= target(state, m) < low + width
        take(state, words, n, np.int64(intervals[n, 0]), np.int64(intervals[n, 1]))
    return held


def drawn(n: int) -> np.ndarray:
    """Intervals of all widths, from one in 2 ** BITS to all of them."""
    rng = np.random.default_rng(n)
    width = 2 ** rng.integers(0, BITS + 1, n)
    return np.column_stack([rng.integers(0, 2**BITS - width + 1), width]).astype(np.uint32)


@pytest.mark.parametrize("n", [0, 1, 3, 4, 5, 1000])
def test_intervals_come_back(n: int) -> None:
    intervals = drawn(n)
    data = encode_intervals(intervals)
    bits = (BITS - np.log2(intervals[:, 1])).sum()
    assert len(data) <= bits / 8 + 8 * STATES + 1
    words = np.frombuffer(data, "<u4").astype(np.uint32)
    state = begin(words)
    assert _decode(state, words, intervals, STATES)
    assert ended(state, words)


def test_what_is_left_or_lacks_is_told() -> None:
    intervals = drawn(100)
    words = np.frombuffer(encode_intervals(intervals), "<u4").astype(np.uint32)
    for other in (words[:-1], np.append(words, words[-1])):
        state = begin(other)
        _decode(state, other, intervals, 1)
        assert not ended(state, other)
    state = begin(words)
    _decode(state, words, intervals[:-1], 1)
    assert not ended(state, words)
