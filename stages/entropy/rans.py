"""Asymmetric numeral coder (range variant, Duda 2013) with static tables: one multiplication a symbol.

A table gives each of C contexts a distribution over A symbols in 1/4096. The state is a whole number in
``[2^31, 2^63)``; words of 32 bits enter it as it falls below. The encoder works backwards, from the last
symbol to the first, and fills its buffer from the end, so that the decoder reads forwards.

Two states take turns, symbol by symbol, so that a decoder need not wait for one symbol to begin with the next; they share the words.
A decoder's are ``(x, other, position)`` in the caller's registers, x that of the next symbol. Past the end it reads the last word again; whether the
words were those of the encoder, :func:`ended` tells: both states are back where the encoder started, and no word is left.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

BITS = 12
TOTAL = 1 << BITS
LOWEST = 1 << 31
Words = NDArray[np.uint32]


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
def slot_of(x: int) -> int:
    """Return the slot, below 4096, whose interval is that of the symbol that the state holds."""
    return x & (TOTAL - 1)


@njit(cache=True, inline="always")
def pop(x: int, start: int, width: int) -> int:
    """Return the state without the symbol of the interval that holds its slot; raw bits and :func:`refill` follow."""
    return width * (x >> BITS) + (x & (TOTAL - 1)) - start


@njit(cache=True, inline="always")
def refill(x: int, position: int, words: Words) -> tuple[int, int]:
    """Return state and position after the word that the state needs, if it does. Without branches, which nobody foresees."""
    short = np.int64(x < LOWEST)
    word = np.int64(words[np.uint64(min(position, len(words) - 1))])
    return int(x << (short << 5) | (word & -short)), int(position + short)


@njit(cache=True, inline="always")
def begin(words: Words) -> tuple[int, int, int]:
    """Return both first states and the position; too few words, or a state that cannot be, give a first state of 0."""
    if len(words) < 4:
        return 0, 0, 0
    x, other = np.int64(words[0]) << 32 | np.int64(words[1]), np.int64(words[2]) << 32 | np.int64(words[3])
    return int(x if min(x, other) >= LOWEST else 0), int(other), 4


@njit(cache=True, inline="always")
def ended(state: tuple[int, int, int], words: Words) -> bool:
    """Tell of both states and the position whether all that was encoded has been decoded, and nothing else."""
    x, other, position = state
    return x == LOWEST and other == LOWEST and position == len(words)


@njit(cache=True, inline="always")
def finish(x: int, other: int, position: int, words: Words) -> int:
    """Put the last states of the encoder, that of the first symbol first, before the other words; returns the new position."""
    for state in (other, x):
        position -= 2
        words[position], words[position + 1] = state >> 32, state & 0xFFFFFFFF
    return position
