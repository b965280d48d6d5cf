"""Asymmetric numeral coder (range variant, Duda 2013) with static tables: one multiplication a symbol.

A table gives each of C contexts a distribution over A symbols in 1/4096. The state is a whole number in
``[2^31, 2^63)``; words of 32 bits enter it as it falls below. The encoder works backwards, from the last
symbol to the first, and fills its buffer from the end, so that the decoder reads forwards.

A decoder finds the interval of a state by its rank: each slot has a bit, set where an interval begins, and the bits up to
a slot are counted. No search, no branch: a decoder waits for every symbol, and a wrong guess of what it will be costs
more than the symbol.

Two states take turns, symbol by symbol, so that a decoder need not wait for one symbol to begin with the next; they share the words.
A decoder's are ``(x, other, position)`` in the caller's registers, x that of the next symbol. Past the end it reads the last word again; whether the
words were those of the encoder, :func:`ended` tells: both states are back where the encoder started, and no word is left.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

BITS = 12
TOTAL = 1 << BITS
LOWEST = 1 << 31
_WORD = 6  # slots of a word of marks, bits
Words = NDArray[np.uint32]


class Slots(NamedTuple):
    """What a decoder looks up, of C contexts with A symbols.

    Attributes:
        marks: ``(C, 64)`` uint64; bit b of word w is set where slot ``64 w + b`` is the first of an interval.
        ranks: ``(C, 64)`` uint8, intervals that begin before a word.
        intervals: ``(C, A + 1)`` uint32: of the r-th interval, from 1 on, its symbol, width (12 bits) and start (12 bits).
    """

    marks: NDArray[np.uint64]
    ranks: NDArray[np.uint8]
    intervals: NDArray[np.uint32]


@dataclass(frozen=True, eq=False)
class Symbols:
    """Distributions of C contexts over A symbols.

    Attributes:
        start: ``(C, A + 1)`` uint16, cumulative frequencies from 0 to 4096; what an encoder looks up.
        slots: what a decoder looks up.
    """

    start: NDArray[np.uint16]
    slots: Slots

    @classmethod
    def of(cls, frequency: NDArray[np.uint16]) -> Symbols:
        """Lay out frequencies ``(C, A)``, each below 4096, A up to 255; they must add up to 4096 in every context."""
        whole = np.cumsum(frequency, axis=1, dtype=np.int64)
        if frequency.shape[1] > 255 or not (whole[:, -1] == TOTAL).all():
            raise ValueError("frequencies do not add up")
        start = np.zeros((len(frequency), frequency.shape[1] + 1), np.uint16)
        start[:, 1:] = whole
        context, symbol = np.nonzero(frequency)
        first, width = start[context, symbol].astype(np.uint32), frequency[context, symbol].astype(np.uint32)
        marked = np.zeros((len(frequency), TOTAL), np.bool_)
        marked[context, first] = True
        marks = np.packbits(marked, axis=1, bitorder="little").view("<u8").astype(np.uint64)
        inside = marked.reshape(len(frequency), -1, 1 << _WORD).sum(2)
        rank = (np.cumsum(frequency > 0, axis=1))[context, symbol]
        intervals = np.zeros(start.shape, np.uint32)
        intervals[context, rank] = symbol.astype(np.uint32) << (2 * BITS) | width << BITS | first
        return cls(start, Slots(marks, (np.cumsum(inside, axis=1) - inside).astype(np.uint8), intervals))


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
def _ones(word: np.uint64) -> np.uint64:
    """Count the bits that are set. Compilers know this form, and make one instruction of it where there is one."""
    word = word - (word >> np.uint64(1) & np.uint64(0x5555555555555555))
    word = (word & np.uint64(0x3333333333333333)) + (word >> np.uint64(2) & np.uint64(0x3333333333333333))
    word = (word + (word >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
    return (word * np.uint64(0x0101010101010101)) >> np.uint64(56)


@njit(cache=True, inline="always")
def pop(x: int, context: int, slots: Slots) -> tuple[int, int]:
    """Return the symbol of a context that the state holds, and the state without it; raw bits and :func:`refill` follow."""
    row, state = np.uint64(context), np.uint64(x)
    slot = state & np.uint64(TOTAL - 1)
    word = slot >> np.uint64(_WORD)
    marks = slots.marks[row, word] << (~slot & np.uint64((1 << _WORD) - 1))
    interval = np.uint64(slots.intervals[row, np.uint64(slots.ranks[row, word]) + _ones(marks)])
    width = interval >> np.uint64(BITS) & np.uint64(TOTAL - 1)
    state = width * (state >> np.uint64(BITS)) + slot - (interval & np.uint64(TOTAL - 1))
    return int(np.int64(interval >> np.uint64(2 * BITS))), int(np.int64(state))


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
