"""Intensities in hundredths, effort ``fast``: a context from the neighbours', given all ranges.

Neighbours count by how near their range is. Whether the value is coded around their mean depends on how well that
did along the ring (activity), and on which side of it the return before lies; tables give each context its own
distribution of the 101 values, so that values that a laser never reports cost nothing.
"""

from __future__ import annotations

import numpy as np
from numba import literal_unroll, njit
from numpy.typing import NDArray

from salpcc.stages.entropy.rans import Words, refill
from salpcc.stages.predict.static import levels
from salpcc.stages.predict.static.columns import LANES, WIDTH, Columns, F, cell, put, renew, take
from salpcc.stages.predict.static.symbols import Starts, pop_symbol
from salpcc.stages.vectors import (
    Lanes,
    choose,
    inline,
    join,
    kernel,
    lane,
    larger,
    load,
    of,
    pick,
    size,
    smaller,
    spread,
)

F32 = NDArray[np.float32]

VALUES = 101
ESCAPE = 101  # followed by 7 even bits
CONTEXTS = 24 * 5 * 7
PAD = 4  # places before and behind the values of a sweep: neighbours are read first, and weigh nothing where there are none
_ZERO, _ONE, _TWO, _FOUR, _SEVEN = F(0.0), F(1.0), F(2.0), F(4.0), F(7.0)
_NEAR = F(40.0)  # ranges that differ by more than 1/40 are another surface's
_FLOOR = F(0.15)
_AHEAD1, _AHEAD2, _AHEAD3 = F(1.2), F(0.8), F(0.5)  # weights of the three returns before,
_ABOVE_FAR, _ABOVE_NEAR = F(0.5), F(0.8)  # of four in the ring above around the same tick,
_ABOVE2 = F(0.5)  # of two in the ring above that
_RATE = F(0.2)
_LEAST = F(1e-3)  # added to the weight of the return before
_PRIOR_VALUE, _PRIOR_ACTIVITY = F(25.0), F(4.0)
_HIGHEST = F(100.0)
_OF_MEAN, _OF_AHEAD, _OF_BIAS, _EXPECTED, _OF_BEFORE = F(0.57), F(0.87), F(0.06), F(0.46), F(0.46)
_SIDES = tuple(F(bound) for bound in (-9.0, -4.0, -1.2, 1.2, 4.0, 9.0))
_ROUGH = tuple(F(bound) for bound in (0.8, 1.8, 3.2, 6.0))
# Where the expected value starts to count as the next of 24 sizes: steps of 1.5 to 12, of 3 to 36, of 8 beyond.
_BOUNDS = np.array([0.75 + 1.5 * k for k in range(8)] + [13.5 + 3.0 * k for k in range(8)] + [40.0 + 8.0 * k for k in range(7)])  # fmt: skip
_OF_SIZE = 35 * np.searchsorted(_BOUNDS, np.arange(401) / 4.0, side="right").astype(np.int64)

# Columns, a place a ring: levels and values of the three returns before, and how many there were; what has been learned along it;
LEVEL1, LEVEL2, LEVEL3, VALUE1, VALUE2, VALUE3, COUNT, ACTIVITY, BIAS = range(9)
# what its return sees: its own level, what weighs differences of levels; sums of the weights and of the weighted values of the rings above;
LEVEL, PER_NEAR, OUTSIDE, SUM = range(9, 13)
# what is guessed: the mean of the neighbours, the context's two parts; and the value that was found.
MEAN, EXPECTED, KIND, FOUND = range(13, 17)
COLUMNS = 17


@njit(cache=True)
def begin() -> Columns:
    """Return the columns before the first returns."""
    columns = np.zeros((COLUMNS, WIDTH), np.float32)
    columns[ACTIVITY], columns[VALUE1] = _PRIOR_ACTIVITY, _PRIOR_VALUE
    return columns.reshape(-1)


@inline
def follow(j: int, end: int, tick: NDArray[np.int32], t: int) -> int:
    """Move from return ``j`` of a ring that ends before ``end`` to its last one not after tick ``t``."""
    while j + 1 < end and tick[np.uint64(j + 1)] <= t:
        j += 1
    return j


@kernel
def place(columns: Columns, of_levels: Columns, first: int, end: int) -> None:
    """Take over the levels of rings ``first`` to before ``end`` from their columns."""
    for at in range(first, end, LANES):
        level = take(of_levels, levels.FOUND, at)
        put(columns, LEVEL, at, level)
        put(columns, PER_NEAR, at, _NEAR / larger(level, _ONE))


@inline
def _nearness(others: Lanes, level: Lanes, per_near: Lanes) -> Lanes:
    """Weights of neighbours by their levels."""
    gap = (others - level) * per_near
    weight = larger(_ONE - gap * gap, _ZERO) + _FLOOR
    return weight * weight


@inline
def _total(vector: Lanes) -> float:
    four = pick(vector, 0, 1, 2, 3) + pick(vector, 4, 5, 6, 7)
    two = pick(four, 0, 1) + pick(four, 2, 3)
    return lane(two, 0) + lane(two, 1)


@inline
def weigh(r, columns, j, above, end, j2, above2, end2, level, value):  # type: ignore[no-untyped-def]
    """Weigh the neighbours of the return of ring ``r`` in the rings above.

    Args:
        j: last return of the ring above that is not after it.  above, end: the first of that ring, and the one after its last known one.
        j2, above2, end2: the same of the ring above that.
        level, value: of all returns, the first at PAD.
    """
    if j > above and j + 2 < end and j2 >= above2 and j2 + 1 < end2:  # as a rule
        weights = of(_ABOVE_FAR, _ABOVE_NEAR, _ABOVE_NEAR, _ABOVE_FAR, _ABOVE2, _ABOVE2, _ZERO, _ZERO)
    else:
        weights = of(
            _ABOVE_FAR if above <= j - 1 else _ZERO,
            _ABOVE_NEAR if above <= j else _ZERO,
            _ABOVE_NEAR if j + 1 < end else _ZERO,
            _ABOVE_FAR if j + 2 < end else _ZERO,
            _ABOVE2 if above2 <= j2 else _ZERO,
            _ABOVE2 if j2 + 1 < end2 else _ZERO,
            _ZERO,
            _ZERO,
        )
    others = join(load(level, j - 1 + PAD, 4), load(level, j2 + PAD, 4))
    values = join(load(value, j - 1 + PAD, 4), load(value, j2 + PAD, 4))
    weights = _nearness(others, columns[cell(LEVEL, r)], columns[cell(PER_NEAR, r)]) * weights
    columns[cell(OUTSIDE, r)] = _total(weights)
    columns[cell(SUM, r)] = _total(weights * values)


@kernel
def guess(columns: Columns, first: int, end: int) -> None:
    """Guess the values of rings ``first`` to before ``end``."""
    one, zero = spread(_ONE, LANES), spread(_ZERO, LANES)
    for at in range(first, end, LANES):
        level, per_near, many = (
            take(columns, LEVEL, at),
            take(columns, PER_NEAR, at),
            take(columns, COUNT, at),
        )
        w1 = (
            choose(many > _ZERO, _nearness(take(columns, LEVEL1, at), level, per_near) * _AHEAD1, zero)
            + _LEAST
        )
        w2 = choose(many > _ONE, _nearness(take(columns, LEVEL2, at), level, per_near) * _AHEAD2, zero)
        w3 = choose(many > _TWO, _nearness(take(columns, LEVEL3, at), level, per_near) * _AHEAD3, zero)
        inner = w1 + (w2 + w3)
        outer = inner + take(columns, OUTSIDE, at)
        part = _ONE / (inner * outer)
        before = take(columns, VALUE1, at)
        known = w1 * before + (w2 * take(columns, VALUE2, at) + w3 * take(columns, VALUE3, at))
        ahead = known * outer * part
        mean = (known + take(columns, SUM, at)) * inner * part
        begun = many > _ZERO
        before, ahead = choose(begun, before, mean), choose(begun, ahead, mean)
        expected = (mean * _OF_MEAN + ahead * _OF_AHEAD) + (
            (take(columns, BIAS, at) * _OF_BIAS + _EXPECTED) - before * _OF_BEFORE
        )
        expected = smaller(larger(expected, _ZERO), _HIGHEST)
        aside, activity = before - expected, take(columns, ACTIVITY, at)
        side = rough = zero
        for bound in literal_unroll(_SIDES):
            side = side + choose(aside >= bound, one, zero)
        for bound in literal_unroll(_ROUGH):
            rough = rough + choose(activity >= bound, one, zero)
        put(columns, MEAN, at, mean)
        put(columns, EXPECTED, at, expected * _FOUR)
        put(columns, KIND, at, rough * _SEVEN + side)


@inline
def context_of(columns: Columns, r: int) -> int:
    """Return the context of the value that is guessed of ring ``r``."""
    expected = np.int64(columns[cell(EXPECTED, r)])
    return _OF_SIZE[np.uint64(expected)] + np.int64(columns[cell(KIND, r)])


@kernel
def learn(columns: Columns, of_levels: Columns, first: int, end: int) -> None:
    """Learn from the values that were found of the active rings among them."""
    for at in range(first, end, LANES):
        active, value = take(of_levels, levels.ACTIVE, at) > _ZERO, take(columns, FOUND, at)
        off = value - take(columns, MEAN, at)
        activity, bias = take(columns, ACTIVITY, at), take(columns, BIAS, at)
        renew(columns, ACTIVITY, at, active, activity + (size(off) - activity) * _RATE)
        renew(columns, BIAS, at, active, bias + (off - bias) * _RATE)
        renew(columns, COUNT, at, active, take(columns, COUNT, at) + _ONE)
        renew(columns, VALUE3, at, active, take(columns, VALUE2, at))
        renew(columns, VALUE2, at, active, take(columns, VALUE1, at))
        renew(columns, VALUE1, at, active, value)
        renew(columns, LEVEL3, at, active, take(columns, LEVEL2, at))
        renew(columns, LEVEL2, at, active, take(columns, LEVEL1, at))
        renew(columns, LEVEL1, at, active, take(columns, LEVEL, at))


@inline
def get(x: int, position: int, words: Words, context: int, starts: Starts) -> tuple[int, int, int]:
    """Decode a value; returns it (from VALUES on: none), state and position."""
    found, x = pop_symbol(x, context, starts, 2)
    if found == ESCAPE:
        found = x & 127
        x >>= 7
    x, position = refill(x, position, words)
    return found, x, position
