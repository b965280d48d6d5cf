"""Earlier occurrences of what comes next, by chains of hashed places: what LZ5 and Lizard choose from."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

_BITS = 16
_DEPTH = 16  # places tried
SHORTEST = 4


@njit(cache=True)
def new_chains(size: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the last place of each hash, and of each place the one before it with the same hash; -1 none."""
    return np.full(1 << _BITS, -1, np.int64), np.full(size, -1, np.int64)


@njit(cache=True)
def _hash(src: NDArray[np.uint8], at: int) -> int:
    word = (
        np.int64(src[at])
        | np.int64(src[at + 1]) << 8
        | np.int64(src[at + 2]) << 16
        | np.int64(src[at + 3]) << 24
    )
    return int(((word * 2654435761) & 0xFFFFFFFF) >> (32 - _BITS))


@njit(cache=True)
def remember(src: NDArray[np.uint8], at: int, head: NDArray[np.int64], before: NDArray[np.int64]) -> None:
    """Enter a place into the chains."""
    if at + SHORTEST <= len(src):
        h = _hash(src, at)
        before[at] = head[h]
        head[h] = at


@njit(cache=True)
def length_at(src: NDArray[np.uint8], at: int, offset: int, end: int) -> int:
    """Return how many bytes before ``end`` repeat those ``offset`` back."""
    n = 0
    if 0 < offset <= at:
        while at + n < end and src[at + n] == src[at + n - offset]:
            n += 1
    return n


@njit(cache=True)
def longest(
    src: NDArray[np.uint8], at: int, end: int, window: int, head: NDArray[np.int64], before: NDArray[np.int64]
) -> tuple[int, int]:
    """Return offset and length of the longest match at a place, up to ``window`` back; (0, 0) for none."""
    best, far = 0, 0
    if at + SHORTEST > end:
        return 0, 0
    place = head[_hash(src, at)]
    for _ in range(_DEPTH):
        if place < 0 or at - place > window:
            break
        n = length_at(src, at, at - place, end)
        if n > best:
            best, far = n, at - place
        place = before[place]
    return (far, best) if best >= SHORTEST else (0, 0)
