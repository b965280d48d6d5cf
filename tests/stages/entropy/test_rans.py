"""The numeral coder gives back what it was given, close to the entropy, and knows what is not its own."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numba import njit

from salpcc.stages.entropy import rans

_FREQUENCY = np.array([[1, 4000, 90, 5], [1024, 1024, 1024, 1024], [4095, 0, 0, 1]], np.uint16)
_START = np.concatenate([np.zeros((3, 1)), np.cumsum(_FREQUENCY, axis=1)], axis=1).astype(np.uint16)


@njit
def _encode(contexts, symbols, bits, raw, start, words):
    x = other = rans.LOWEST
    at = len(words)
    for back in range(len(symbols)):
        i = len(symbols) - 1 - back
        low = np.int64(start[contexts[i], symbols[i]])
        width = np.int64(start[contexts[i], symbols[i] + 1]) - low
        other, at = rans.push(other, at, words, low, width, bits[i], raw[i])
        x, other = other, x
    return rans.finish(x, other, at, words)


@njit
def _decode(contexts, bits, start, words):
    symbols, raw = np.zeros_like(contexts), np.zeros_like(contexts)
    x, other, at = rans.begin(words)
    if x == 0:
        return symbols, raw, False
    for i in range(len(contexts)):
        ends = start[contexts[i], 1:]
        symbols[i] = np.searchsorted(ends, np.uint16(rans.slot_of(x)), side="right")
        low = np.int64(start[contexts[i], symbols[i]])
        x = rans.pop(x, low, np.int64(ends[symbols[i]]) - low)
        raw[i] = x & ((1 << bits[i]) - 1)
        x, at = rans.refill(x >> bits[i], at, words)
        x, other = other, x
    return symbols, raw, rans.ended((x, other, at), words)


def drawn(n: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Contexts, symbols of their frequencies, numbers of raw bits, raw bits."""
    rng = np.random.default_rng(seed)
    contexts = rng.integers(0, 3, n)
    slots = rng.integers(0, rans.TOTAL, n)
    symbols = np.array(
        [np.searchsorted(_START[c][1:], s, side="right") for c, s in zip(contexts, slots, strict=True)],
        np.int64,
    )
    bits = rng.integers(0, 20, n)
    return contexts, symbols, bits, rng.integers(0, 1 << 19, n) & ((1 << bits) - 1)


def written(contexts, symbols, bits, raw) -> np.ndarray:
    words = np.empty(len(contexts) + 4, np.uint32)
    return words[_encode(contexts, symbols, bits, raw, _START, words) :].copy()


@given(st.integers(0, 300), st.integers(0, 2**32 - 1))
def test_round_trip(n: int, seed: int) -> None:
    contexts, symbols, bits, raw = drawn(n, seed)
    words = written(contexts, symbols, bits, raw)
    got, even, sound = _decode(contexts, bits, _START, words)
    assert sound
    np.testing.assert_array_equal(got, symbols)
    np.testing.assert_array_equal(even, raw)


def test_size_is_near_the_entropy() -> None:
    contexts, symbols, bits, raw = drawn(20_000, 0)
    ideal = -np.log2(_FREQUENCY[contexts, symbols] / rans.TOTAL).sum() + bits.sum()
    assert 32 * len(written(contexts, symbols, bits, raw)) < 1.001 * ideal + 128


def test_damage_stays_inside_and_a_cut_is_known() -> None:
    contexts, symbols, bits, raw = drawn(500, 1)
    good = written(contexts, symbols, bits, raw)
    rng = np.random.default_rng(2)
    for trial in range(100):
        bad = good.copy()
        bad[rng.integers(0, len(bad))] ^= np.uint32(1 << int(rng.integers(0, 32)))
        bad = bad if trial % 2 else bad[: rng.integers(0, len(bad) - 1)]
        got, _, sound = _decode(contexts, bits, _START, bad)
        assert got.max() <= 3
        assert len(bad) == len(good) or not sound  # flipped even bits are for checksums
