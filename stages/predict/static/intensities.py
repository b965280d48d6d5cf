"""Intensities in hundredths, effort ``fast``: a context from the neighbours', given all ranges.

Neighbours count by how near their range is. Whether the value is coded around their mean depends on how well that
did along the ring (activity), and on which side of it the return before lies; tables give each context its own
distribution of the 101 values, so that values that a laser never reports cost nothing.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from salpcc.stages.entropy.rans import begin, drop, ended, find, refill
from salpcc.stages.predict.sweep_walk import longest_ring

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


@njit(cache=True, inline="always")
def _nearness(other: int, level: int, per_near: float) -> float:
    """Weight of a neighbour by its level."""
    gap = (other - level) * per_near
    weight = _FLOOR + max(1.0 - gap * gap, 0.0)
    return weight * weight


@njit(cache=True, error_model="numpy")
def _neighbours(first, end, above, above2, tick, level, value, before, others):  # type: ignore[no-untyped-def]
    """Weigh the neighbours of the returns ``first`` to ``end`` of a ring.

    Args:
        above, above2: first return of the ring above (it ends at ``first``) and of that above it.
        before: receives the weights of the three returns before, and 1 over their sum, ``(4, n)``.
        others: receives the weighted sum of the values of the rings above, and 1 over all weights, ``(2, n)``.
    """
    j = above - 1
    j2 = above2 - 1
    for i in range(first, end):
        at = i - first
        here = np.int64(level[i])
        t = tick[i]
        per_near = _NEAR / max(here + 0.0, 1.0)
        while j + 1 < first and tick[j + 1] <= t:
            j += 1
        while j2 + 1 < above and tick[j2 + 1] <= t:
            j2 += 1
        total = _LEAST
        for back in range(3):
            weight = _AHEAD[back] * _nearness(level[i - 1 - back], here, per_near) if at > back else 0.0
            before[back, at] = weight
            total += weight
        before[3, at] = 1.0 / total
        mean = 0.0
        for u in range(max(j - 1, above), min(j + 3, first)):
            weight = _ABOVE[u - j + 1] * _nearness(level[u], here, per_near)
            total += weight
            mean += weight * value[u]
        for u in range(max(j2, above2), min(j2 + 2, above)):
            weight = _ABOVE2 * _nearness(level[u], here, per_near)
            total += weight
            mean += weight * value[u]
        others[0, at] = mean
        others[1, at] = 1.0 / total


@njit(cache=True, error_model="numpy", nogil=True)
def walk_intensities(  # type: ignore[no-untyped-def]
    decoding, starts, tick, level, value, context, start, guide, words
):
    """Find the contexts of the intensities of a sweep, and decode them on the way if asked to.

    Args:
        starts: first return of each ring, ``(L + 1,)``.  tick, level: ``(M,)``.
        value: uint8 ``(M,)`` of 0..100, read, or filled when decoding.
        context: uint16 ``(M,)``, filled unless decoding.
        start, guide, words: tables and words to decode from.

    Returns:
        whether the words were those of an encoder.
    """
    size = longest_ring(starts)
    before = np.zeros((4, size))
    others = np.zeros((2, size))
    x = 0
    position = 0
    if decoding:
        x, position = begin(words)
        if x == 0:
            return False
    above = 0
    above2 = 0
    for k in range(len(starts) - 1):
        first = starts[k]
        end = starts[k + 1]
        if end == first:
            continue
        _neighbours(first, end, above, above2, tick, level, value, before, others)
        activity = 4.0
        bias = 0.0
        v1 = 25.0
        v2 = 0.0
        v3 = 0.0
        for i in range(first, end):
            at = i - first
            # Written so that what the value before decides comes last: a decoder waits for it.
            further = before[1, at] * v2 + before[2, at] * v3
            weight = before[0, at] + _LEAST
            ahead = weight * before[3, at] * v1 + further * before[3, at]
            mean = weight * others[1, at] * v1 + (further + others[0, at]) * others[1, at]
            if i == first:
                v1 = ahead = mean
            expected = (0.57 * mean + 0.87 * ahead) + ((0.06 * bias + 0.46) - 0.46 * v1)
            expected = min(max(expected, 0.0), 100.0)
            aside = v1 - expected
            side = (
                np.int64(aside >= -9.0)
                + np.int64(aside >= -4.0)
                + np.int64(aside >= -1.2)
                + np.int64(aside >= 1.2)
                + np.int64(aside >= 4.0)
                + np.int64(aside >= 9.0)
            )
            rough = (
                np.int64(activity >= 0.8)
                + np.int64(activity >= 1.8)
                + np.int64(activity >= 3.2)
                + np.int64(activity >= 6.0)
            )
            c = (_SIZE[np.int64(expected * 4.0)] * 5 + rough) * 7 + side
            if decoding:
                found = find(x, c, start, guide)
                x = drop(x, np.int64(start[c, found]), np.int64(start[c, found + 1]))
                if found == ESCAPE:
                    found = x & 127
                    x >>= 7
                    if found >= VALUES:
                        return False
                x, position = refill(x, position, words)
                value[i] = found
            else:
                found = np.int64(value[i])
                context[i] = c
            v3 = v2
            v2 = v1
            v1 = np.float64(found)
            off = v1 - mean
            activity += _RATE * (abs(off) - activity)
            bias += _RATE * (off - bias)
        above2 = above
        above = first
    return (not decoding) or ended(x, position, words)
