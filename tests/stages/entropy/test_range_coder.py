"""The range coder gives back what it was given, close to the entropy, and never leaves its buffer."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import njit

from salpcc.stages.entropy import range_coder as rc


@njit
def _encode(bits, contexts, symbols, cumulative, out):
    model = np.full((4, 2), 1 << 15, np.uint16)
    state = rc.start_encoder()
    for i in range(len(bits)):
        rc.encode_bit(state, out, model, contexts[i], bits[i])
        s = symbols[i]
        rc.encode_interval(state, out, cumulative[s], cumulative[s + 1] - cumulative[s], 16)
    return rc.finish_encoder(state, out)


@njit
def _decode(data, contexts, cumulative):
    model = np.full((4, 2), 1 << 15, np.uint16)
    state = rc.start_decoder(data)
    bits = np.zeros(len(contexts), np.int64)
    symbols = np.zeros(len(contexts), np.int64)
    for i in range(len(contexts)):
        bits[i] = rc.decode_bit(state, data, model, contexts[i])
        target = rc.decode_target(state, 16)
        s = 0
        while cumulative[s + 1] <= target:
            s += 1
        symbols[i] = s
        rc.decode_interval(state, data, cumulative[s], cumulative[s + 1] - cumulative[s], 16)
    return bits, symbols, state[3]


_CUMULATIVE = np.array([0, 1, 2, 60000, 65535, 65536])


@settings(max_examples=60)
@given(st.integers(0, 400), st.integers(0, 2**32 - 1), st.floats(0, 1))
def test_round_trip(n, seed, p):
    rng = np.random.default_rng(seed)
    bits = (rng.random(n) < p).astype(np.int64)
    contexts = rng.integers(0, 4, n)
    symbols = rng.integers(0, 5, n)
    out = np.zeros(8 * n + 16, np.uint8)
    size = _encode(bits, contexts, symbols, _CUMULATIVE, out)
    got_bits, got_symbols, overrun = _decode(out[:size].copy(), contexts, _CUMULATIVE)
    assert (got_bits == bits).all()
    assert (got_symbols == symbols).all()
    assert not overrun


def test_size_is_near_the_entropy():
    rng = np.random.default_rng(0)
    n = 50_000
    bits = (rng.random(n) < 0.05).astype(np.int64)
    symbols = np.searchsorted(_CUMULATIVE, rng.integers(0, 65536, n), side="right") - 1
    out = np.zeros(8 * n, np.uint8)
    size = _encode(bits, np.zeros(n, np.int64), symbols, _CUMULATIVE, out)
    widths = np.diff(_CUMULATIVE)[symbols]
    ideal = n * 0.2864 + np.log2(65536 / widths).sum()
    assert 8 * size < 1.02 * ideal + 64


def test_a_full_buffer_is_reported():
    rng = np.random.default_rng(0)
    n = 1000
    out = np.zeros(10, np.uint8)
    bits = rng.integers(0, 2, n)
    assert _encode(bits, np.zeros(n, np.int64), rng.integers(0, 5, n), _CUMULATIVE, out) == -1


def test_random_bytes_decode_without_harm():
    rng = np.random.default_rng(1)
    for size in (0, 1, 7, 100):
        data = rng.integers(0, 256, size).astype(np.uint8)
        _, symbols, overrun = _decode(data, np.zeros(5000, np.int64), _CUMULATIVE)
        assert symbols.max() <= 4
        assert overrun
