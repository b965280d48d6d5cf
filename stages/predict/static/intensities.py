"""Intensities in hundredths, effort ``fast``: a context from the neighbours', given all ranges.

Neighbours count by how near their range is. Whether the value is coded around their mean depends on how well that
did along the ring (activity), and on which side of it the return before lies; tables give each context its own
distribution of the 101 values, so that values that a laser never reports cost nothing.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from salpcc.stages.entropy.rans import Slots, Words, pop, refill
from salpcc.stages.predict.vectors import count, inline, of

VALUES = 101
ESCAPE = 101  # followed by 7 even bits
CONTEXTS = 24 * 5 * 7
_NEAR = 40.0  # ranges that differ by more than 1/40 are another surface's
_FLOOR = 0.15
_AHEAD = (1.2, 0.8, 0.5)  # weights of the three returns before,
_ABOVE = (0.5, 0.8, 0.8, 0.5)  # of four in the ring above around the same tick,
_ABOVE2 = 0.5  # of two in the ring above that
_RATE = 0.2
_LEAST = 1e-3  # added to the weight of the return before
# Where the expected value starts to count as the next of 24 sizes: steps of 1.5 to 12, of 3 to 36, of 8 beyond.
_BOUNDS = np.array([0.75 + 1.5 * k for k in range(8)] + [13.5 + 3.0 * k for k in range(8)] + [40.0 + 8.0 * k for k in range(7)])  # fmt: skip
_SIZE = np.searchsorted(_BOUNDS, np.arange(401) / 4.0, side="right").astype(np.int64)


class Around(NamedTuple):
    """The neighbours of a return, weighed.

    Attributes:
        w1, w2, w3: weights of the three returns before.  inner: 1 over their sum.
        sum: of the weighted values of the rings above.  outer: 1 over all weights.
    """

    w1: float
    w2: float
    w3: float
    inner: float
    sum: float
    outer: float


@inline
def _nearness(other: int, level: int, per_near: float) -> float:
    """Weight of a neighbour by its level."""
    gap = (other - level) * per_near
    weight = _FLOOR + max(1.0 - gap * gap, 0.0)
    return weight * weight


@inline
def _before(back, at, i, level, here, per_near):  # type: ignore[no-untyped-def]
    other = np.int64(level[np.uint64(max(i - back, 0))])
    return _AHEAD[back - 1] * _nearness(other, here, per_near) if at >= back else 0.0


@inline
def weigh(first, at, j, j2, above, above2, level, value) -> Around:  # type: ignore[no-untyped-def]
    """Weigh the neighbours of return number ``at`` of a ring.

    Args:
        first, above, above2: first return of the ring, of the ring above (which ends there), of that above it.
        j, j2: last returns of the rings above that are not after it.
    """
    i = first + at
    here = np.int64(level[np.uint64(i)])
    per_near = _NEAR / max(here + 0.0, 1.0)
    w1 = _before(1, at, i, level, here, per_near)
    w2 = _before(2, at, i, level, here, per_near)
    w3 = _before(3, at, i, level, here, per_near)
    total = _LEAST + w1 + w2 + w3
    inner = 1.0 / total
    mean = 0.0
    for k in range(4):
        u = j - 1 + k
        if u >= above and u < first:
            weight = _ABOVE[k] * _nearness(np.int64(level[np.uint64(u)]), here, per_near)
            total += weight
            mean += weight * value[np.uint64(u)]
    for u in range(j2, j2 + 2):
        if u >= above2 and u < above:
            weight = _ABOVE2 * _nearness(np.int64(level[np.uint64(u)]), here, per_near)
            total += weight
            mean += weight * value[np.uint64(u)]
    return Around(w1, w2, w3, inner, mean, 1.0 / total)


@inline
def follow(j, end, tick, t):  # type: ignore[no-untyped-def]
    """Move from return ``j`` of a ring that ends before ``end`` to its last one not after tick ``t``."""
    while j + 1 < end and tick[np.uint64(j + 1)] <= t:
        j += 1
    return j


class Running(NamedTuple):
    """What has been learned along a ring: how well the mean did, and the three values before."""

    activity: float
    bias: float
    v1: float
    v2: float
    v3: float


@inline
def begin_ring() -> Running:
    """Return what is known before the first return of a ring."""
    return Running(4.0, 0.0, 25.0, 0.0, 0.0)


@inline
def guess(known: Running, around: Around, at: int) -> tuple[int, float]:
    """Return the context of return ``at`` of a ring, and the mean of its neighbours."""
    # Written so that what the value before decides comes last: a decoder waits for it.
    further = around.w2 * known.v2 + around.w3 * known.v3
    weight = around.w1 + _LEAST
    ahead = weight * around.inner * known.v1 + further * around.inner
    mean = weight * around.outer * known.v1 + (further + around.sum) * around.outer
    v1 = known.v1
    if at == 0:
        v1 = ahead = mean
    expected = (0.57 * mean + 0.87 * ahead) + ((0.06 * known.bias + 0.46) - 0.46 * v1)
    expected = min(max(expected, 0.0), 100.0)
    aside = v1 - expected
    side = count(aside >= of(-9.0, -4.0, -1.2, 1.2, 4.0, 9.0, np.inf, np.inf))
    rough = count(known.activity >= of(0.8, 1.8, 3.2, 6.0))
    return (_SIZE[np.uint64(expected * 4.0)] * 5 + rough) * 7 + side, mean


@inline
def learn(known: Running, mean: float, found: int) -> Running:
    """Return what is known after a value."""
    value = np.float64(found)
    off = value - mean
    activity = known.activity + _RATE * (abs(off) - known.activity)
    return Running(activity, known.bias + _RATE * (off - known.bias), value, known.v1, known.v2)


@inline
def get(x: int, position: int, words: Words, context: int, slots: Slots) -> tuple[int, int, int]:
    """Decode a value; returns it (from VALUES on: none), state and position."""
    found, x = pop(x, context, slots)
    if found == ESCAPE:
        found = x & 127
        x >>= 7
    x, position = refill(x, position, words)
    return found, x, position
