"""Residuals as tokens and even bits (the hybrid integers of JPEG XL, with the sign in the lowest bit).

A residual ``r`` splits into ``u = r >> s``, coded as a token, and its s lowest bits, which are as good as even where
large residuals are expected. ``z = 2 u`` or ``-2 u - 1``; below 32 it is its own token, above the token holds the
size, the bit below the leading one and the sign, and the bits between are even. What no table foresaw is the
token ESCAPE and ``z`` of the whole residual.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.entropy.rans import BITS, push, refill
from salpcc.stages.predict.static.symbols import Starts, pop_symbol
from salpcc.stages.vectors import inline

ESCAPE = 64
TOKENS = 65
_PLAIN = 32
_PLAIN_SIZE = 5
_HIGH, _LOW = 11, 10  # even bits of an escaped residual, below 2 ** 20 in magnitude
ESCAPED_BITS = _HIGH + _LOW
_LARGE = 20  # contexts of an octave of expected errors


@njit(cache=True, inline="always")
def shift_of(context: int) -> int:
    """Return the number of lowest bits that are even in a context of levels."""
    return max(context // _LARGE - 5, 0)


@njit(cache=True, inline="always")
def split(residual: int, shift: int) -> tuple[int, int, int]:
    """Return token (ESCAPE or above: too large), number of even bits, even bits of a residual."""
    u = residual >> shift
    low = residual & ((1 << shift) - 1)
    z = u << 1 ^ u >> 63
    if z < _PLAIN:
        return z, shift, low
    size = (np.float64(z).view(np.int64) >> 52) - 1023
    token = _PLAIN + (size - _PLAIN_SIZE) * 4 + (z >> (size - 1) & 1) * 2 + (z & 1)
    between = z >> 1 & ((1 << (size - 2)) - 1)
    return int(token), int(size - 2 + shift), int(between << shift | low)


@njit(cache=True, inline="always")
def put(
    x: int, position: int, words: NDArray[np.uint32], context: int, residual: int, start: NDArray[np.uint16]
) -> tuple[int, int]:
    """Encode a residual of magnitude below 2 ** 20; returns state and position."""
    row = np.uint64(context)
    token, bits, even = split(residual, shift_of(context))
    if token < ESCAPE:
        low = np.int64(start[row, np.uint64(token)])
        width = np.int64(start[row, np.uint64(token + 1)]) - low
        if width > 0:
            return push(x, position, words, low, width, bits, even)
    z = residual << 1 ^ residual >> 63
    low = np.int64(start[row, ESCAPE])
    x, position = push(x, position, words, 0, 1 << BITS, _LOW, z & ((1 << _LOW) - 1))
    return push(x, position, words, low, (1 << BITS) - low, _HIGH, z >> _LOW)


@inline
def get(
    x: int, position: int, words: NDArray[np.uint32], context: int, starts: Starts
) -> tuple[int, int, int]:
    """Decode a residual; returns it, state and position. Inverse of :func:`put`."""
    token, x = pop_symbol(x, context, starts, 1)
    if token == ESCAPE:
        z = x & ((1 << _HIGH) - 1)
        x, position = refill(x >> _HIGH, position, words)
        z = z << _LOW | (x & ((1 << _LOW) - 1))
        x, position = refill(x >> _LOW, position, words)
        return (z >> 1) ^ -(z & 1), x, position
    shift = shift_of(context)
    # No branches: nobody foresees which it is.
    large = np.int64(token >= _PLAIN)
    between = (token - _PLAIN + 12) >> 2 & -large
    bits = shift + between
    even = x & ((1 << bits) - 1)
    x, position = refill(x >> bits, position, words)
    leading = (2 | (token >> 1 & 1)) << (between + 1) | even >> shift << 1 | (token & 1)
    z = token + ((leading - token) & -large)
    u = (z >> 1) ^ -(z & 1)
    return u << shift | (even & ((1 << shift) - 1)), x, position


@njit(cache=True)
def count_tokens(
    context: NDArray[np.uint8],
    residual: NDArray[np.int32],
    counts: NDArray[np.int64],
) -> None:
    """Add the tokens of residuals ``(M,)`` to ``counts`` ``(C, TOKENS)``."""
    for i in range(len(context)):
        token, _, _ = split(np.int64(residual[i]), shift_of(np.int64(context[i])))
        counts[context[i], min(token, ESCAPE)] += 1
