"""Asymmetric numeral coder (range variant, Duda 2013) with static tables: one multiplication a symbol.

A table gives each of C contexts a distribution over A symbols in 1/4096. The state is a whole number in
``[2^31, 2^63)``; words of 32 bits enter it as it falls below. The encoder works backwards, from the last
symbol to the first, and fills its buffer from the end, so that the decoder reads forwards.

A decoder state is ``(x, position)`` in the caller's registers. Past the end it reads the last word again; whether the
words were those of the encoder, :func:`ended` tells: the state is back where the encoder started, and no word is left.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

BITS = 12
TOTAL = 1 << BITS
LOWEST = 1 << 31
_GUIDE = 3  # slots of a guide entry, bits
Words = NDArray[np.uint32]


@dataclass(frozen=True, eq=False)
class Symbols:
    """Distributions of C contexts over A symbols.

    Attributes:
        start: ``(C, A + 1)`` uint16, cumulative frequencies from 0 to 4096.
        guide: ``(C, 256)`` uint8, the symbol that holds each sixteenth slot.
    """

    start: NDArray[np.uint16]
    guide: NDArray[np.uint8]

    @classmethod
    def of(cls, frequency: NDArray[np.uint16]) -> Symbols:
        """Lay out frequencies ``(C, A)``, A up to 256; they must add up to 4096 in every context."""
        whole = np.cumsum(frequency, axis=1, dtype=np.int64)
        if frequency.shape[1] > 256 or not (whole[:, -1] == TOTAL).all():
            raise ValueError("frequencies do not add up")
        start = np.zeros((len(frequency), frequency.shape[1] + 1), np.uint16)
        start[:, 1:] = whole
        slots = np.arange(0, TOTAL, 1 << _GUIDE)
        guide = np.stack([np.searchsorted(row[1:], slots, side="right") for row in start]).astype(np.uint8)
        return cls(start, guide)


@njit(cache=True, inline="always")
def push(x: int, position: int, words: Words, start: int, width: int, bits: int, raw: int) -> tuple[int, int]:
    """Encode the interval ``[start, start + width)`` of 4096 and, after it, ``raw`` of up to 19 bits.

    ``width`` is below 4096. Returns the state and the position, which moves towards 0 by at most one word.
    """
    if x >= width << (63 - BITS - bits):
        position -= 1
        words[position] = x & 0xFFFFFFFF
        x >>= 32
    x = x << bits | raw
    whole = np.int64(np.uint64(x) // np.uint64(width))
    return int((whole << BITS) + (x - whole * width) + start), position


@njit(cache=True, inline="always")
def find(x: int, context: int, start: NDArray[np.uint16], guide: NDArray[np.uint8]) -> int:
    """Symbol of a context that the state holds."""
    row = np.uint64(context)
    slot = np.uint64(x & (TOTAL - 1))
    symbol = np.uint64(guide[row, slot >> np.uint64(_GUIDE)])
    while np.uint64(start[row, symbol + np.uint64(1)]) <= slot:
        symbol += np.uint64(1)
    return int(np.int64(symbol))


@njit(cache=True, inline="always")
def drop(x: int, low: int, high: int) -> int:
    """Take the interval ``[low, high)`` that holds the state out of it; raw bits and :func:`refill` follow."""
    return (high - low) * (x >> BITS) + (x & (TOTAL - 1)) - low


@njit(cache=True, inline="always")
def refill(x: int, position: int, words: Words) -> tuple[int, int]:
    """Return state and position after the word that the state needs, if it does. Without branches, which nobody foresees."""
    short = np.int64(x < LOWEST)
    word = np.int64(words[np.uint64(min(position, len(words) - 1))])
    return int(x << (short << 5) | (word & -short)), int(position + short)


@njit(cache=True, inline="always")
def begin(words: Words) -> tuple[int, int]:
    """Return the first state and position; fewer than two words, or a state that cannot be, give 0."""
    if len(words) < 2:
        return 0, 0
    x = np.int64(words[0]) << 32 | np.int64(words[1])
    return int(x if x >= LOWEST else 0), 2


@njit(cache=True, inline="always")
def ended(x: int, position: int, words: Words) -> bool:
    """Tell whether all that was encoded has been decoded, and nothing else."""
    return x == LOWEST and position == len(words)


@njit(cache=True, inline="always")
def finish(x: int, position: int, words: Words) -> int:
    """Put the last state of the encoder before the other words; returns the new position."""
    words[position - 1] = x & 0xFFFFFFFF
    words[position - 2] = x >> 32
    return position - 2
