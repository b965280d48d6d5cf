"""Intervals of intensities from a network's answer, and the value that a point of the interval belongs to.

Values stand in lanes: ``v`` at lane ``v // ROWS`` of row ``v % ROWS``, so that the sums of all lanes grow side by side
and those before a value are found in two short steps.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from salpcc.stages.vectors import (
    cast,
    count,
    highest,
    inline,
    larger,
    load,
    running,
    spread,
    store,
)

BITS = 24
VALUES = 101  # intensities 0 to 100
OUTPUTS = 104  # VALUES, padded
ROWS, LANES = 7, 16
OUTPUT_PLACES = tuple(value % ROWS * LANES + value // ROWS for value in range(VALUES))
ROOM = ROWS * LANES + LANES

_BEYOND = ROWS * LANES - VALUES  # places after the last value; their frequency is 1
_ONE, _ZERO = np.float32(1.0), np.float32(0.0)
_FINE = np.float32(16384.0)
_NOTHING, _LEAST = np.int32(0), np.int32(1)

I32 = NDArray[np.int32]


@inline
def frequencies(sums: I32, p: int, shift: int, freq: I32, to: int) -> int:
    """Turn logits, row ``p`` of ``sums``, in units of ``2 ** -shift`` into integer frequencies, each at least 1; returns their sum.

    ``(1 + l / 16) ^ 16`` stands in for ``exp(l)``. Row ``to`` of ``freq`` (points, ROOM) gets the frequencies and, behind them, the sums
    of the lanes up to each.
    """
    at, start = p * sums.shape[1], to * ROOM
    top = load(sums, at, 16)
    for row in range(1, ROWS):
        top = larger(top, load(sums, at + row * LANES, 16))
    largest = highest(top)
    link = _ONE / np.float32(16 << shift)
    lanes = spread(_NOTHING, 16)
    for row in range(ROWS):
        p = larger(cast(load(sums, at + row * LANES, 16) - largest, np.float32) * link + _ONE, _ZERO)
        p = p * p
        p = p * p
        p = p * p
        p = p * p
        f = cast(p * _FINE, np.int32) + _LEAST
        store(freq, start + row * LANES, f)
        lanes = lanes + f
    lanes = running(lanes)
    store(freq, start + ROWS * LANES, lanes)
    return int(freq[np.uint64(to), np.uint64(ROOM - 1)]) - _BEYOND


@inline
def frequency(freq: I32, p: int, value: int) -> int:
    """Return the frequency of a value by row ``p``."""
    return int(freq[np.uint64(p), np.uint64(value % ROWS * LANES + value // ROWS)])


@inline
def value_start(freq: I32, p: int, value: int) -> int:
    """Return how many counts stand before a value."""
    lane, last = np.uint64(value) // np.uint64(ROWS), value % ROWS
    below = int(freq[np.uint64(p), np.uint64(ROWS * LANES) + lane])
    for row in range(last, ROWS):
        below -= int(freq[np.uint64(p), np.uint64(row * LANES) + lane])
    return below


@inline
def find_value(freq: I32, p: int, total: int, target: int) -> tuple[int, int]:
    """Return the last value whose scaled start is not after the target, and the counts before it."""
    wanted = (((target + 1) * total + (1 << BITS) - 1) >> BITS) - 1
    lane = count(load(freq, p * ROOM + ROWS * LANES, 16) < np.int32(wanted + 1))
    at = np.uint64(lane)
    below = int(freq[np.uint64(p), np.uint64(ROWS * LANES) + at])
    for row in range(ROWS):
        below -= int(freq[np.uint64(p), np.uint64(row * LANES) + at])
    value, start = ROWS * lane, below
    for row in range(ROWS - 1):
        below += int(freq[np.uint64(p), np.uint64(row * LANES) + at])
        if below <= wanted:
            value, start = ROWS * lane + row + 1, below
    return value, start
