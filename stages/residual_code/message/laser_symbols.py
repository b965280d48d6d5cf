"""Columns of few small values that follow from the laser: ring numbers, kinds of returns. By value, as the laser last had it."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.entropy.buffer import as_array
from salpcc.stages.entropy.range_coder import finish_encoder, new_bits, start_decoder, start_encoder
from salpcc.stages.entropy.walks import code_mixed_bit, code_mixed_tree

I64 = NDArray[np.int64]


@njit(cache=True)
def _code(
    writing: bool,
    state: NDArray[np.int64],
    data: NDArray[np.uint8],
    values: NDArray[np.int64],
    laser: NDArray[np.uint8],
    lasers: int,
    bits: NDArray[np.uint16],
) -> None:
    """Write or read values ``(N,)`` of 0 to 255; lasers from 0 to ``lasers``."""
    last = np.full(lasers + 1, -1)
    before, misses = np.int64(0), np.int64(0)
    for i in range(len(laser)):
        k = laser[i]
        new = last[k] < 0
        if not new:
            at = 1 + misses
            new = (
                code_mixed_bit(writing, state, data, bits, at, bits, at, np.int64(values[i] != last[k])) == 1
            )
            misses = (misses * 2 + np.int64(new)) & 7
        if new:
            row = 16 + before * 256
            values[i] = code_mixed_tree(writing, state, data, bits, row, bits, row, 8, values[i])
        elif not writing:
            values[i] = last[k]
        if not writing and state[3] != 0:
            return
        last[k] = before = values[i]


def encode_by_laser(values: I64, laser: I64, lasers: int) -> bytes:
    """Encode values ``(N,)`` of 0 to 255 of points of lasers ``(N,)``, 0 to ``lasers``."""
    out = np.empty(16 * len(values) + 4096, np.uint8)  # a bit costs 11 at most
    state = start_encoder()
    _code(True, state, out, values, laser, lasers, new_bits(16 + 256 * 256))
    return out[: int(finish_encoder(state, out))].tobytes()


def decode_by_laser(laser: I64, lasers: int, data: bytes) -> tuple[I64, bool]:
    """Inverse of :func:`encode_by_laser`: the values, and whether the data made sense."""
    raw = as_array(data)
    values, state = np.zeros(len(laser), np.int64), start_decoder(raw)
    _code(False, state, raw, values, laser, lasers, new_bits(16 + 256 * 256))
    return values, bool(state[3] == 0)
