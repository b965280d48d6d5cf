"""A mixture of logistics as an exact cumulative distribution over levels.

All tables are made by repeated multiplication and division from a few constants, so they are the same
on every machine; evaluation uses float64 with ``+ - * /`` in a fixed order.

A mixture is a float64 array of the PLACES means in counts, then the inverse scales, then the weights, which sum to 1. A
component that is dropped stays in its place with weight 0, which adds nothing to any sum.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from salpcc.stages.predict.vectors import cast, highest, inline, larger, load, smaller, store, summed

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I32 = NDArray[np.int32]

BITS = 24
TOTAL = 1 << BITS
PLACES = 16  # of components
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
def set_mixture(sums: I32, shift: int, mu: F32, components: int, mixture: F64, work: I32) -> None:
    """Turn a network's answer and the predictions into a mixture.

    Args:
        sums: PLACES logits, offsets in units of the scale, log scales, all in units of ``2 ** -shift``.
        mu: ``(PLACES,)`` predicted counts of the components, SHARED ones included.
        work: scratch, ``(2 * PLACES,)``.
    """
    logits = load(sums, 0, 16)
    fine = np.int32(shift - 5)  # 32 steps a unit
    depth = smaller((highest(logits) - logits) >> fine, _LAST_WEIGHT)
    store(work, 0, depth)
    low = np.int32((_LOG_SCALE_SHIFT - _LOG_SCALE_LOW) << shift)
    store(work, 16, larger(smaller((load(sums, 32, 16) + low) >> fine, _LAST_SCALE), _ZERO))
    unit = 1.0 / (1 << shift)
    total = 0.0
    for c in range(components):
        weight = WEIGHTS[np.uint64(work[c])]
        mixture[_WEIGHTS + c] = weight
        total += weight
        scale = np.uint64(work[16 + c])
        offset = min(max(sums[16 + c] * unit, -_OFFSET_LIMIT), _OFFSET_LIMIT)
        mixture[_MEANS + c] = np.float64(mu[c]) + offset * SCALES[scale, 0]
        mixture[_INVERSES + c] = SCALES[scale, 1]
    for c in range(0, 16, 8):
        store(mixture, _WEIGHTS + c, load(mixture, _WEIGHTS + c, 8) / total)


@inline
def _below(mixture: F64, components: int, x: float, at: int, places: I32, parts: F64) -> float:
    """The share of the mixture below ``x`` counts, from 0 to 1 and a little; scratch begins at ``at``."""
    for c in range(0, 16, 8):
        z = (x - load(mixture, _MEANS + c, 8)) * load(mixture, _INVERSES + c, 8)
        z = (larger(smaller(z, _Z_LIMIT), -_Z_LIMIT) + _Z_LIMIT) * _Z_STEPS
        k = cast(z, np.int32)
        store(places, at + c, k)
        store(parts, at + c, z - cast(k, np.float64))
    f = 0.0
    for c in range(components):
        k = np.uint64(places[at + c])
        f += mixture[_WEIGHTS + c] * (LOGISTIC[k, _LOW] + parts[at + c] * LOGISTIC[k, _SLOPE])
    return f


@inline
def level_ends(
    mixture: F64, components: int, level: int, step: int, levels: int, places: I32, parts: F64
) -> tuple[int, int]:
    """Return the two ends of a level in [0, TOTAL]; every level below ``levels`` keeps at least width 1.

    ``places`` (2 * PLACES,) and ``parts`` (2 * PLACES,) are scratch.
    """
    x = level * step - 0.5
    below = _below(mixture, components, x, 0, places, parts)
    up_to = _below(mixture, components, x + step, PLACES, places, parts)
    low = level + int(min(below, 1.0) * (TOTAL - levels))
    high = level + 1 + int(min(up_to, 1.0) * (TOTAL - levels))
    return 0 if level <= 0 else low, TOTAL if level + 1 >= levels else high


@inline
def find_level(
    mixture: F64, components: int, target: int, step: int, levels: int, places: I32, parts: F64
) -> tuple[int, int, int]:
    """Return the level whose interval holds ``target``, and the interval's two ends.

    The search starts at the mean of where the components have it, each by its density, and takes Newton steps; where one
    leads out of what is left, or after many, it halves that. Levels only ever start later than those before them, so
    the way does not matter.
    """
    low_half = load(mixture, _WEIGHTS, 8) * load(mixture, _INVERSES, 8)
    high_half = load(mixture, _WEIGHTS + 8, 8) * load(mixture, _INVERSES + 8, 8)
    density = summed(0.0, low_half + high_half, 0, 8)
    moment = low_half * load(mixture, _MEANS, 8) + high_half * load(mixture, _MEANS + 8, 8)
    quantile = _GUESSES[np.uint64(target) >> np.uint64(BITS - 8)]
    guess = ((summed(0.0, moment, 0, 8) + quantile) / density + 0.5) / step
    first, last = 0, levels - 1
    level = min(max(int(min(max(guess, 0.0), 1e6)), first), last)
    tries = 0
    while True:
        tries += 1
        low, high = level_ends(mixture, components, level, step, levels, places, parts)
        if target < low and level > first:
            last = level - 1
        elif target >= high and level < last:
            first = level + 1
        else:
            return level, low, high
        guess = level + ((target + 0.5) - low) / (high - low)
        level = int(guess) if first <= guess < last + 1 and tries < _NEWTON else (first + last) >> 1
