"""Values that come with their predicted interval, by asymmetric numerals (:mod:`.rans`): nothing is left to do but to code them.

Intervals are of ``2 ** BITS``. STATES states take turns, value by value, and share the words, so that a decoder may look for as many values
at a time: :func:`target` tells of each, :func:`take` goes on to the next, in order.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.entropy.rans import LOWEST, Words, refill

BITS = 24
STATES = 4
_MASK = (1 << BITS) - 1
_POSITION = STATES  # where a decoder's state has it, behind the states


@njit(cache=True)
def _encode(intervals: NDArray[np.uint32], words: Words) -> int:
    state = np.full(STATES, LOWEST, np.int64)
    position = len(words)
    for back in range(len(intervals)):
        n = len(intervals) - 1 - back
        start, width = np.uint64(intervals[n, 0]), np.uint64(intervals[n, 1])
        x = np.uint64(state[n % STATES])
        if x >= width << np.uint64(63 - BITS):
            position -= 1
            words[position] = x & np.uint64(0xFFFFFFFF)
            x >>= np.uint64(32)
        whole = x // width
        state[n % STATES] = (whole << np.uint64(BITS)) + (x - whole * width) + start
    for x in state[::-1]:
        position -= 2
        words[position], words[position + 1] = x >> 32, x & 0xFFFFFFFF
    return position


def encode_intervals(intervals: NDArray[np.uint32]) -> bytes:
    """Encode starts and widths ``(M, 2)``, in the order of decoding."""
    words = np.empty(len(intervals) + 2 * STATES, np.uint32)
    return words[_encode(intervals, words) :].astype("<u4", copy=False).tobytes()


def begin(words: Words) -> NDArray[np.int64]:
    """Return the state of a decoder at the start of ``words``, at least ``2 * STATES``."""
    first = words[: 2 * STATES].astype(np.int64)
    return np.append(first[::2] << 32 | first[1::2], 2 * STATES)


def ended(state: NDArray[np.int64], words: Words) -> bool:
    """Tell whether all that was encoded has been decoded, and nothing else."""
    return bool((state[:STATES] == LOWEST).all() and state[_POSITION] == len(words))


@njit(cache=True, inline="always")
def target(state: NDArray[np.int64], n: int) -> int:
    """Return what lies in the interval of value ``n``, if the values before ``n + 1 - STATES`` were taken."""
    return int(state[np.uint64(n % STATES)] & _MASK)


@njit(cache=True, inline="always")
def take(state: NDArray[np.int64], words: Words, n: int, start: int, width: int) -> None:
    """Take value ``n``, which has an interval, out of the state."""
    at = np.uint64(n % STATES)
    x = width * (state[at] >> BITS) + (state[at] & _MASK) - start
    state[at], state[np.uint64(_POSITION)] = refill(x, state[np.uint64(_POSITION)], words)
