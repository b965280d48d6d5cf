"""A mixture of logistics as an exact cumulative distribution over levels.

All tables are made by repeated multiplication and division from a few constants, so they are the same
on every machine; evaluation uses float64 with ``+ - * /`` in a fixed order.

A mixture is a row of a float64 array: the PLACES means in counts, then the inverse scales, then the weights, which sum to 1. A
component that is dropped has weight 0 and no place, as it would add nothing to any sum.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from salpcc.stages.predict.vectors import (
    cast,
    highest,
    inline,
    larger,
    load,
    smaller,
    spread,
    store,
    summed,
)

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I32 = NDArray[np.int32]

BITS = 24
TOTAL = 1 << BITS
PLACES = 16  # of components
_SIZE = 3 * PLACES
SHARED = (9, 0)  # predictors of the components beyond the first ten
_MEANS, _INVERSES, _WEIGHTS, _LOW, _SLOPE = 0, 16, 32, 0, 1
_PER_UNIT = 32
_CUT = 9  # components whose logit is this far below the largest are dropped
_LOG_SCALE_SHIFT, _LOG_SCALE_LOW, _LOG_SCALE_HIGH = 2, -2, 9
_OFFSET_LIMIT = 8.0
_Z_LIMIT = 17.0
_Z_STEPS = 64.0
_EXP_32ND = 1.0317434074991028  # exp(1 / 32)
_EXP_64TH = 1.0157477085866857  # exp(1 / 64)
_EXP_MINUS_2 = 0.1353352832366127
_EXP_17 = 24154952.7535753


def _powers(first: float, factor: float, n: int) -> F64:
    out = np.empty(n)
    value = first
    for k in range(n):
        out[k] = value
        value *= factor
    return out


def _logistic_table() -> F64:
    """Logistic at -17, -17 + 1/64, ..., 17, and its step to the next; its two ends are forced to 0 and 1."""
    n = int(2 * _Z_LIMIT * _Z_STEPS) + 2
    table = 1.0 / (1.0 + _powers(_EXP_17, 1.0 / _EXP_64TH, n))
    table[0] = 0.0
    table[-2:] = 1.0
    return np.column_stack([table, np.append(np.diff(table), 0.0)])


_SCALES = _powers(_EXP_MINUS_2, _EXP_32ND, (_LOG_SCALE_HIGH - _LOG_SCALE_LOW) * _PER_UNIT + 1)
SCALES = np.column_stack([_SCALES, 1.0 / _SCALES])
WEIGHTS = np.append(_powers(1.0, 1.0 / _EXP_32ND, _CUT * _PER_UNIT), 0.0)
LOGISTIC = _logistic_table()
_GUESSES = np.interp(
    (np.arange(256) + 0.5) / 256, LOGISTIC[:, 0], np.arange(len(LOGISTIC)) / _Z_STEPS - _Z_LIMIT
)
_NEWTON = 16  # steps at most
_LAST_WEIGHT, _LAST_SCALE = np.int32(len(WEIGHTS) - 1), np.int32(len(SCALES) - 1)
_ZERO = np.int32(0)


def output_places(predictors: int) -> tuple[int, ...]:
    """Where the outputs of a network of so many predictors stand: PLACES logits, offsets, log scales."""
    components = predictors + len(SHARED)
    return tuple(part * PLACES + c for part in range(3) for c in range(components))


@inline
def set_mixture(
    sums: I32, p: int, shift: int, mu: F32, to: int, components: int, mixture: F64, work: I32
) -> int:
    """Turn a network's answer, row ``p`` of ``sums``, and the predictions into a mixture, row ``to`` of ``mixture``; returns how many components it keeps.

    Args:
        sums: PLACES logits, offsets in units of the scale, log scales, all in units of ``2 ** -shift``.
        mu: its row ``to`` is the predicted counts of the components, SHARED ones included.
        work: scratch, ``(2 * PLACES,)``.
    """
    row, m = p * sums.shape[1], np.uint64(to)
    logits = load(sums, row, 16)
    fine = np.int32(shift - 5)  # 32 steps a unit
    depth = smaller((highest(logits) - logits) >> fine, _LAST_WEIGHT)
    store(work, 0, depth)
    low = np.int32((_LOG_SCALE_SHIFT - _LOG_SCALE_LOW) << shift)
    store(work, 16, larger(smaller((load(sums, row + 32, 16) + low) >> fine, _LAST_SCALE), _ZERO))
    unit = 1.0 / (1 << shift)
    total, kept = 0.0, 0
    for c in range(0, PLACES, 8):
        store(mixture, to * _SIZE + _WEIGHTS + c, spread(0.0, 8))
    for c in range(components):
        weight = WEIGHTS[np.uint64(work[np.uint64(c)])]
        total += weight
        scale = np.uint64(work[np.uint64(16 + c)])
        offset = sums[np.uint64(p), np.uint64(16 + c)] * unit
        offset = min(max(offset, -_OFFSET_LIMIT), _OFFSET_LIMIT)
        mixture[m, np.uint64(_WEIGHTS + kept)] = weight
        mixture[m, np.uint64(_MEANS + kept)] = np.float64(mu[m, np.uint64(c)]) + offset * SCALES[scale, 0]
        mixture[m, np.uint64(_INVERSES + kept)] = SCALES[scale, 1]
        kept += int(weight > 0.0)
    for c in range(0, PLACES, 8):
        at = to * _SIZE + _WEIGHTS + c
        store(mixture, at, load(mixture, at, 8) / total)
    return kept


@inline
def _below(mixture: F64, m: int, components: int, x: float, at: int, places: I32, parts: F64) -> float:
    """The share of the mixture below ``x`` counts, from 0 to 1 and a little; scratch begins at ``at``."""
    for c in range(0, 16, 8):
        z = (x - load(mixture, m * _SIZE + _MEANS + c, 8)) * load(mixture, m * _SIZE + _INVERSES + c, 8)
        z = (larger(smaller(z, _Z_LIMIT), -_Z_LIMIT) + _Z_LIMIT) * _Z_STEPS
        k = cast(z, np.int32)
        store(places, at + c, k)
        store(parts, at + c, z - cast(k, np.float64))
    f = 0.0
    for c in range(components):
        k = np.uint64(places[np.uint64(at + c)])
        f += mixture[np.uint64(m), np.uint64(_WEIGHTS + c)] * (
            LOGISTIC[k, _LOW] + parts[np.uint64(at + c)] * LOGISTIC[k, _SLOPE]
        )
    return f


@inline
def level_ends(
    mixture: F64, m: int, components: int, level: int, step: int, levels: int, places: I32, parts: F64
) -> tuple[int, int]:
    """Return the two ends of a level in [0, TOTAL] by mixture ``m``; every level below ``levels`` keeps at least width 1.

    ``places`` (2 * PLACES,) and ``parts`` (2 * PLACES,) are scratch.
    """
    x = level * step - 0.5
    below = _below(mixture, m, components, x, 0, places, parts)
    up_to = _below(mixture, m, components, x + step, PLACES, places, parts)
    low = level + int(min(below, 1.0) * (TOTAL - levels))
    high = level + 1 + int(min(up_to, 1.0) * (TOTAL - levels))
    return 0 if level <= 0 else low, TOTAL if level + 1 >= levels else high


@inline
def _guess(mixture: F64, m: int, target: int, step: int, levels: int) -> int:
    """Return the level at the mean of where the components of mixture ``m`` have a target, each by its density."""
    at = m * _SIZE
    low_half = load(mixture, at + _WEIGHTS, 8) * load(mixture, at + _INVERSES, 8)
    high_half = load(mixture, at + _WEIGHTS + 8, 8) * load(mixture, at + _INVERSES + 8, 8)
    density = summed(0.0, low_half + high_half, 0, 8)
    moment = low_half * load(mixture, at + _MEANS, 8) + high_half * load(mixture, at + _MEANS + 8, 8)
    quantile = _GUESSES[np.uint64(target) >> np.uint64(BITS - 8)]
    guess = ((summed(0.0, moment, 0, 8) + quantile) / density + 0.5) / step
    return min(int(min(max(guess, 0.0), 1e6)), levels - 1)


@inline
def find_levels(  # type: ignore[no-untyped-def]
    mixture, first, n, components, step, levels, search, places, parts
):
    """Find for each of ``n`` mixtures, from ``first`` on, the level whose interval holds its target, and the interval's two ends.

    A search starts at :func:`_guess` and takes Newton steps; where one leads out of what is left, or after many, it halves that. Levels
    only ever start later than those before them, so the way does not matter. All take their steps in turns, so that none waits for its own, and
    without branches, which nobody foresees.

    Args:
        components: of each mixture.
        search: int64 ``(7, n at least)``: targets in row 0; levels, their ends in rows 1, 2, 3 on return; 4 to 6 are scratch.
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
            column, m = np.uint64(waiting), first + waiting
            target, level = search[0, column], search[1, column]
            low, high = level_ends(mixture, m, components[m], level, step, levels, places, parts)
            lowest, topmost = search[4, column], search[5, column]
            before, after = target < low and level > lowest, target >= high and level < topmost
            lowest, topmost = level + 1 if after else lowest, level - 1 if before else topmost
            guess = level + ((target + 0.5) - low) / (high - low)
            straight = lowest <= guess < topmost + 1 and tries < _NEWTON
            to = int(min(max(guess, 0.0), 1e6)) if straight else (lowest + topmost) >> 1
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
