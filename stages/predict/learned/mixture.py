"""A mixture of logistics as an exact cumulative distribution over levels.

Exponentials are powers (:mod:`~salpcc.stages.entropy.powers`), so the distribution never falls, and it is the same on every machine.

A mixture is a row of a float32 array: the PLACES means in counts, then the inverse scales, then the weights, which sum to what the levels
share. A place without a component has weight 0.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from salpcc.stages.entropy.powers import above, to_the_256th
from salpcc.stages.vectors import (
    Lanes,
    cast,
    highest,
    inline,
    lane,
    larger,
    load,
    smaller,
    store,
    totals,
)

F32 = NDArray[np.float32]
I64 = NDArray[np.int64]
I32 = NDArray[np.int32]

BITS = 24
TOTAL = 1 << BITS
PLACES = 16  # of components
SIZE = 3 * PLACES
SHARED = (9, 0)  # predictors of the components beyond the first ten
_MEANS, _INVERSES, _WEIGHTS = 0, 16, 32
_SCALE_SHIFT, _SCALE_LOW, _SCALE_HIGH = np.float32(2.0), np.float32(-2.0), np.float32(9.0)  # logarithms
_OFFSET_LIMIT = np.float32(8.0)
_PER_256, _PER_4096 = np.float32(1.0 / 256), np.float32(1.0 / 4096)
_ZERO, _HALF, _ONE, _TWO = np.float32(0.0), np.float32(0.5), np.float32(1.0), np.float32(2.0)
_PART = np.float32(1.0 / TOTAL)
_MIDDLES = (np.arange(256) + 0.5) / 256
_GUESSES = np.log(_MIDDLES / (1.0 - _MIDDLES)).astype(np.float32)  # only where a search begins
_NEWTON = 16  # steps at most


def output_places(predictors: int) -> tuple[int, ...]:
    """Where the outputs of a network of so many predictors stand: PLACES logits, offsets, log scales."""
    components = predictors + len(SHARED)
    return tuple(part * PLACES + c for part in range(3) for c in range(components))


@inline
def set_mixture(sums: I32, p: int, shift: int, mu: F32, to: int, levels: int, mixture: F32) -> None:
    """Turn a network's answer, row ``p`` of ``sums``, and the predictions into a mixture over so many levels, row ``to`` of ``mixture``.

    Args:
        sums: PLACES logits, offsets in units of the scale, log scales, all in units of ``2 ** -shift``.
        mu: its row ``to`` is the predicted counts of the components, SHARED ones included.
    """
    row, at = p * sums.shape[1], to * SIZE
    unit = _ONE / np.float32(1 << shift)
    logits = load(sums, row, 16)
    depth = cast(highest(logits) - logits, np.float32) * unit
    weight = to_the_256th(larger(_ONE - depth * _PER_256, _ZERO))
    log_scale = cast(load(sums, row + 32, 16), np.float32) * unit + _SCALE_SHIFT
    inverse = _ONE - larger(smaller(log_scale, _SCALE_HIGH), _SCALE_LOW) * _PER_4096
    inverse = inverse * inverse
    inverse = inverse * inverse
    inverse = inverse * inverse
    inverse = to_the_256th(inverse * inverse)
    offset = cast(load(sums, row + 16, 16), np.float32) * unit
    offset = larger(smaller(offset, _OFFSET_LIMIT), -_OFFSET_LIMIT)
    store(mixture, at + _MEANS, load(mu, to * PLACES, 16) + offset / inverse)
    store(mixture, at + _INVERSES, inverse)
    share = np.float32(TOTAL - levels) / lane(totals(weight), 0)
    store(mixture, at + _WEIGHTS, weight * share)


@inline
def _below(mixture: F32, m: int, x: np.float32) -> Lanes:
    """What each component of mixture ``m`` has below ``x`` counts."""
    at = m * SIZE
    z = (x - load(mixture, at + _MEANS, 16)) * load(mixture, at + _INVERSES, 16)
    return load(mixture, at + _WEIGHTS, 16) * (_ONE - above(z))


@inline
def level_ends(mixture: F32, m: int, level: int, step: int, levels: int) -> tuple[int, int]:
    """Return the two ends of a level in [0, TOTAL] by mixture ``m``; every level below ``levels`` keeps at least width 1."""
    x, then = np.float32(level * step) - _HALF, np.float32((level + 1) * step) - _HALF
    ends = totals(_below(mixture, m, x), _below(mixture, m, then))
    low = level + min(int(lane(ends, 0)), TOTAL - levels)
    high = level + 1 + min(int(lane(ends, 1)), TOTAL - levels)
    return 0 if level <= 0 else low, TOTAL if level + 1 >= levels else high


@inline
def _guess(mixture: F32, m: int, target: int, step: int, levels: int) -> int:
    """Return the level at the mean of where the components of mixture ``m`` have a target, each by its density."""
    at = m * SIZE
    density = load(mixture, at + _WEIGHTS, 16) * load(mixture, at + _INVERSES, 16)
    sums = totals(density, density * load(mixture, at + _MEANS, 16))
    share = np.float32(TOTAL - levels) * _GUESSES[np.uint64(target) >> np.uint64(BITS - 8)]
    counts = (lane(sums, 1) + share) / lane(sums, 0) + _HALF
    return min(int(max(counts, _ZERO)) // step, levels - 1)


@inline
def _ahead(target: int, low: int, high: int) -> np.float32:
    """Return how many levels a target is from the middle of one with these ends, as if the distribution were one logistic."""
    wanted, here = (np.float32(target) + _HALF) * _PART, np.float32(low + high) * (_HALF * _PART)
    odd = (wanted + here - _TWO * wanted * here) * (np.float32(high - low) * _PART)
    return (wanted - here) * (_TWO * here * (_ONE - here)) / odd


@inline
def find_levels(mixture: F32, first: int, n: int, step: int, levels: int, search: I64) -> None:
    """Find for each of ``n`` mixtures, from ``first`` on, the level whose interval holds its target, and the interval's two ends.

    A search starts at :func:`_guess` and goes :func:`_ahead`; where that leads out of what is left, or after many steps, it halves what is left. Levels
    only ever start later than those before them, so the way does not matter. All take their steps in turns, so that none waits for its own, and
    without branches, which nobody foresees.

    Args:
        search: ``(7, n at least)``: targets in row 0; levels, their ends in rows 1, 2, 3 on return; 4 to 6 are scratch.
    """
    for p in range(n):
        search[1, p] = _guess(mixture, first + p, search[0, p], step, levels)
        search[4, p], search[5, p], search[6, p] = 0, levels - 1, p
    tries = 0
    while n > 0:
        tries += 1
        left = 0
        for at in range(n):
            waiting = search[6, np.uint64(at)]
            column = np.uint64(waiting)
            target, level = search[0, column], search[1, column]
            low, high = level_ends(mixture, first + waiting, level, step, levels)
            lowest, topmost = search[4, column], search[5, column]
            before, after = target < low and level > lowest, target >= high and level < topmost
            lowest, topmost = level + 1 if after else lowest, level - 1 if before else topmost
            guess = np.float32(level) + _HALF + _ahead(target, low, high)
            straight = lowest <= guess < topmost + 1 and tries < _NEWTON
            to = int(guess) if straight else (lowest + topmost) >> 1
            search[1, column] = to if before or after else level
            search[2, column], search[3, column], search[4, column], search[5, column] = (
                low,
                high,
                lowest,
                topmost,
            )
            search[6, np.uint64(left)] = waiting
            left += int(before or after)
        n = left
