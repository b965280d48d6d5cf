"""Columns of integers, row by row, each against the row before: the plain path.

Strays and scans without a lattice go through here: float32 values as ordered integers, or indices
of the grid of a guaranteed error.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.entropy.range_coder import (
    decode_bit,
    decode_interval,
    decode_target,
    encode_bit,
    encode_interval,
    finish_encoder,
    new_bits,
    start_decoder,
    start_encoder,
)

_SIZES = 48  # magnitudes below 2 ** 47
_PER_CONTEXT = 1 + _SIZES * 4
_LIMIT = 1 << 46


def integer_model(columns: int) -> NDArray[np.uint16]:
    """Return the adaptive bits of rows of ``columns`` integers."""
    return new_bits(columns * (_SIZES + 1) * _PER_CONTEXT)


@njit(cache=True)
def _size(magnitude: int) -> int:
    size = 0
    while (magnitude >> size) != 0:
        size += 1
    return size


@njit(cache=True)
def encode_integers(rows: NDArray[np.int64], model: NDArray[np.uint16], out: NDArray[np.uint8]) -> int:
    """Encode ``(S, C)`` integers of magnitude below 2 ** 46; bytes written to ``out``, -1 if full."""
    state = start_encoder()
    columns = rows.shape[1]
    sizes = np.zeros(columns, np.int64)
    for i in range(len(rows)):
        for c in range(columns):
            residual = rows[i, c] - (rows[i - 1, c] if i > 0 else 0)
            base = (c * (_SIZES + 1) + sizes[c]) * _PER_CONTEXT
            magnitude = abs(residual)
            size = _size(magnitude)
            for s in range(size):
                encode_bit(state, out, model, base + 1 + 4 * s, 1)
            encode_bit(state, out, model, base + 1 + 4 * size, 0)
            if size > 0:
                encode_bit(state, out, model, base, 1 if residual < 0 else 0)
            for b in range(size - 2, -1, -1):
                bit = (magnitude >> b) & 1
                if b >= size - 3:
                    node = 2 if b == size - 2 else 3
                    encode_bit(state, out, model, base + 1 + 4 * size + node - 1, bit)
                else:
                    encode_interval(state, out, bit, 1, 1)
            sizes[c] = size
    return finish_encoder(state, out)


@njit(cache=True)
def decode_integers(
    n: int, columns: int, model: NDArray[np.uint16], data: NDArray[np.uint8]
) -> tuple[NDArray[np.int64], bool]:
    """Inverse of :func:`encode_integers`; the rows ``(n, columns)`` and whether the data sufficed."""
    rows = np.zeros((n, columns), np.int64)
    state = start_decoder(data)
    sizes = np.zeros(columns, np.int64)
    for i in range(n):
        for c in range(columns):
            base = (c * (_SIZES + 1) + sizes[c]) * _PER_CONTEXT
            size = 0
            while size < _SIZES - 1 and decode_bit(state, data, model, base + 1 + 4 * size) == 1:
                size += 1
            negative = size > 0 and decode_bit(state, data, model, base) == 1
            magnitude = 1 if size > 0 else 0
            for b in range(size - 2, -1, -1):
                if b >= size - 3:
                    node = 2 if b == size - 2 else 3
                    bit = decode_bit(state, data, model, base + 1 + 4 * size + node - 1)
                else:
                    bit = decode_target(state, 1)
                    decode_interval(state, data, bit, 1, 1)
                magnitude = magnitude << 1 | bit
            value = (rows[i - 1, c] if i > 0 else 0) + (-magnitude if negative else magnitude)
            if abs(value) > _LIMIT or state[3] != 0:
                return rows, False
            rows[i, c] = value
            sizes[c] = size
    return rows, True
