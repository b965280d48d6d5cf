"""Columns of integers, row by row, each against the row before: the plain path.

Strays and scans without a lattice go through here: float32 values as ordered integers, or indices
of the grid of a guaranteed error.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.entropy.buffer import run_encoder
from salpcc.stages.entropy.range_coder import new_bits
from salpcc.stages.entropy.walks import code_bit, code_raw, failed, finish_coder, start_coder, uncounted

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


@uncounted
def _walk(
    writing: bool,
    state: NDArray[np.int64],
    sizes: NDArray[np.int64],
    rows: NDArray[np.int64],
    model: NDArray[np.uint16],
    buffer: NDArray[np.uint8],
) -> int:
    """Code rows ``(S, C)``; returns bytes written, 0 when reading, -1 for a buffer too small or data that cannot be."""
    columns = rows.shape[1]
    for i in range(len(rows)):
        for c in range(columns):
            before = rows[i - 1, c] if i > 0 else np.int64(0)
            residual = rows[i, c] - before
            base = (c * (_SIZES + 1) + sizes[c]) * _PER_CONTEXT
            known = abs(residual)
            length = _size(known)
            size = 0
            while (
                size < _SIZES - 1
                and code_bit(writing, state, buffer, model, base + 1 + 4 * size, 1 if size < length else 0)
                == 1
            ):
                size += 1
            negative = (
                size > 0 and code_bit(writing, state, buffer, model, base, 1 if residual < 0 else 0) == 1
            )
            magnitude = np.int64(1 if size > 0 else 0)
            for b in range(size - 2, -1, -1):
                bit = (known >> b) & 1
                if b >= size - 3:
                    node = 2 if b == size - 2 else 3
                    bit = code_bit(writing, state, buffer, model, base + 1 + 4 * size + node - 1, bit)
                else:
                    bit = code_raw(writing, state, buffer, 1, bit)
                magnitude = magnitude << 1 | bit
            value = before + (-magnitude if negative else magnitude)
            if failed(state) or (not writing and abs(value) > _LIMIT):
                return -1
            rows[i, c] = value
            sizes[c] = size
    return finish_coder(writing, state, buffer)


@njit(cache=True)
def encode_integers(rows: NDArray[np.int64], model: NDArray[np.uint16], out: NDArray[np.uint8]) -> int:
    """Encode ``(S, C)`` integers of magnitude below 2 ** 46; bytes written to ``out``, -1 if full.

    >>> rows, out = np.array([[1, -7], [2, -7]]), np.zeros(64, np.uint8)
    >>> size = encode_integers(rows, integer_model(2), out)
    >>> decode_integers(2, 2, integer_model(2), out[:size])[0].tolist()
    [[1, -7], [2, -7]]
    """
    return _walk(True, start_coder(True, out), np.zeros(rows.shape[1], np.int64), rows.copy(), model, out)


@njit(cache=True)
def decode_integers(
    n: int, columns: int, model: NDArray[np.uint16], data: NDArray[np.uint8]
) -> tuple[NDArray[np.int64], bool]:
    """Inverse of :func:`encode_integers`; the rows ``(n, columns)`` and whether the data sufficed."""
    rows = np.zeros((n, columns), np.int64)
    return rows, _walk(False, start_coder(False, data), np.zeros(columns, np.int64), rows, model, data) == 0


def encode_column(values: NDArray[np.int64]) -> bytes:
    """Encode one column ``(N,)``.

    >>> decode_column(3, np.frombuffer(bytearray(encode_column(np.array([1, 2, -7]))), np.uint8))[0].tolist()
    [1, 2, -7]
    """
    rows = values[:, None]
    return run_encoder(lambda out: int(encode_integers(rows, integer_model(1), out)), len(rows))


def decode_column(n: int, data: NDArray[np.uint8]) -> tuple[NDArray[np.int64], bool]:
    """Inverse of :func:`encode_column`: the values ``(n,)`` and whether the data sufficed."""
    rows, sound = decode_integers(n, 1, integer_model(1), data)
    return rows.ravel(), bool(sound)
