"""Columns of few small values, losslessly: by value, in the context of the neighbours that others predict from."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.entropy.columns import Flags, Values, neighbours
from salpcc.stages.entropy.range_coder import (
    decode_mixed_bit,
    encode_mixed_bit,
    finish_encoder,
    new_bits,
    start_decoder,
    start_encoder,
)


def _symbol_models() -> tuple[NDArray[np.uint16], NDArray[np.uint16]]:
    return new_bits(1 << 17), new_bits(1 << 17)


@njit(cache=True)
def _encode_symbols(
    values: Values,
    void: Flags,
    period: int,
    a: NDArray[np.uint16],
    b: NDArray[np.uint16],
    out: NDArray[np.uint8],
) -> int:
    state = start_encoder()
    last = np.full((2, 2), -1, np.int64)
    for i in range(len(values)):
        left, _, above, _ = neighbours(values, void, i, period, last)
        kind = 1 if void[i] else 0
        f = (kind * 256 + left) * 256
        g = (kind * 256 + above) * 256
        node = 1
        for shift in range(7, -1, -1):
            bit = (values[i] >> shift) & 1
            encode_mixed_bit(state, out, a, f + node, b, g + node, bit)
            node = node * 2 + bit
        last[kind, 0] = i
    return finish_encoder(state, out)


@njit(cache=True)
def _decode_symbols(
    void: Flags, period: int, a: NDArray[np.uint16], b: NDArray[np.uint16], data: NDArray[np.uint8]
) -> tuple[Values, bool]:
    values = np.zeros(len(void), np.int64)
    state = start_decoder(data)
    last = np.full((2, 2), -1, np.int64)
    for i in range(len(void)):
        left, _, above, _ = neighbours(values, void, i, period, last)
        kind = 1 if void[i] else 0
        f = (kind * 256 + left) * 256
        g = (kind * 256 + above) * 256
        node = 1
        for _ in range(8):
            node = node * 2 + decode_mixed_bit(state, data, a, f + node, b, g + node)
        if state[3] != 0:
            return values, False
        values[i] = node & 255
        last[kind, 0] = i
    return values, True


def encode_symbols(values: Values, void: Flags, period: int) -> bytes:
    """Encode values ``(N,)`` of 0 to 255."""
    out = np.empty(16 * len(values) + 4096, np.uint8)  # a bit costs 11 at most
    written = int(_encode_symbols(values, void, period, *_symbol_models(), out))
    assert written >= 0
    return out[:written].tobytes()


def decode_symbols(void: Flags, period: int, data: bytes) -> tuple[Values, bool]:
    """Inverse of :func:`encode_symbols`."""
    raw = np.frombuffer(bytearray(data), np.uint8)
    values, sound = _decode_symbols(void, period, *_symbol_models(), raw)
    return values, bool(sound)
