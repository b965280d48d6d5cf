"""A mixture of logistics as an exact cumulative distribution over levels.

All tables are made by repeated multiplication and division from a few constants, so they are the same
on every machine; evaluation uses float64 with ``+ - * /`` in a fixed order.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

F64 = NDArray[np.float64]

BITS = 24
TOTAL = 1 << BITS
COMPONENTS = 12
SHARED = (9, 0)  # predictors of the components beyond the first ten
_PER_UNIT = 32.0
_CUT = 9.0  # components whose logit is this far below the largest are dropped
_LOG_SCALE_SHIFT, _LOG_SCALE_LOW, _LOG_SCALE_HIGH = 2.0, -2.0, 9.0
_OFFSET_LIMIT = 8.0
_Z_LIMIT = 17.0
_Z_STEPS = 64.0
_EXP_32ND = 1.0317434074991028  # exp(1 / 32)
_EXP_64TH = 1.0157477085866857  # exp(1 / 64)
_EXP_MINUS_2 = 0.1353352832366127
_EXP_17 = 24154952.7535753


@njit(cache=True, error_model="numpy")
def _powers(first: float, factor: float, n: int) -> F64:
    out = np.empty(n)
    value = first
    for k in range(n):
        out[k] = value
        value *= factor
    return out


def _logistic_table() -> F64:
    """Logistic at -17, -17 + 1/64, ..., 17; its two ends are forced to 0 and 1."""
    n = int(2 * _Z_LIMIT * _Z_STEPS) + 2
    table = 1.0 / (1.0 + _powers(_EXP_17, 1.0 / _EXP_64TH, n))
    table[0] = 0.0
    table[-2:] = 1.0
    return table


SCALES = _powers(_EXP_MINUS_2, _EXP_32ND, int((_LOG_SCALE_HIGH - _LOG_SCALE_LOW) * _PER_UNIT) + 1)
INVERSE_SCALES = 1.0 / SCALES
WEIGHTS = _powers(1.0, 1.0 / _EXP_32ND, int(_CUT * _PER_UNIT) + 1)
LOGISTIC = _logistic_table()


@njit(cache=True, error_model="numpy")
def set_mixture(out: NDArray[np.float32], mu: NDArray[np.float32], mix: F64) -> int:
    """Turn network outputs and predictions into components; returns how many there are.

    ``mix`` (3, COMPONENTS) gets means in counts, inverse scales, and weights that sum to 1.
    Outputs: COMPONENTS logits, offsets in units of the scale, log scales; the base and the return to the left
    count twice.
    """
    components = len(mu) + len(SHARED)
    largest = out[0]
    for c in range(1, components):
        largest = max(largest, out[c])
    n = 0
    total = 0.0
    for c in range(components):
        depth = float(largest) - float(out[c])
        if depth >= _CUT:
            continue
        weight = WEIGHTS[int(depth * _PER_UNIT)]
        offset = min(max(float(out[components + c]), -_OFFSET_LIMIT), _OFFSET_LIMIT)
        log_scale = float(out[2 * components + c]) + _LOG_SCALE_SHIFT
        log_scale = min(max(log_scale, _LOG_SCALE_LOW), _LOG_SCALE_HIGH)
        s = int((log_scale - _LOG_SCALE_LOW) * _PER_UNIT)
        predictor = c if c < len(mu) else SHARED[c - len(mu)]
        mix[0, n] = mu[predictor] + offset * SCALES[s]
        mix[1, n] = INVERSE_SCALES[s]
        mix[2, n] = weight
        total += weight
        n += 1
    for c in range(n):
        mix[2, c] /= total
    return n


@njit(cache=True, error_model="numpy")
def cumulative(mix: F64, n: int, x: float) -> tuple[float, float]:
    """Return the mixture's distribution function at ``x`` counts and its density there."""
    f = 0.0
    density = 0.0
    for c in range(n):
        z = (x - mix[0, c]) * mix[1, c]
        z = (min(max(z, -_Z_LIMIT), _Z_LIMIT) + _Z_LIMIT) * _Z_STEPS
        k = int(z)
        low = LOGISTIC[k]
        slope = LOGISTIC[k + 1] - low
        f += mix[2, c] * (low + (z - k) * slope)
        density += mix[2, c] * mix[1, c] * slope
    return f, density * _Z_STEPS


@njit(cache=True, error_model="numpy")
def level_start(mix: F64, n: int, level: int, step: int, levels: int) -> int:
    """Return where ``level`` begins in [0, TOTAL]; every level below ``levels`` keeps at least width 1."""
    if level <= 0:
        return 0
    if level >= levels:
        return TOTAL
    f, _ = cumulative(mix, n, level * step - 0.5)
    return level + int(min(f, 1.0) * (TOTAL - levels))


@njit(cache=True, error_model="numpy")
def find_level(mix: F64, n: int, target: int, step: int, levels: int) -> tuple[int, int, int]:
    """Return the level whose interval holds ``target``, and the interval's two ends.

    Newton steps from the heaviest component, then a walk and bisection on the exact integer ends.
    """
    best = 0
    for c in range(1, n):
        if mix[2, c] > mix[2, best]:
            best = c
    low, high = 0, levels  # level_start(low) <= target < level_start(high)
    low_end, high_end = 0, TOTAL
    x = mix[0, best]
    inverse_step = 1.0 / step
    tries = 0
    while high - low > 1:
        tries += 1
        level = int(min(max((x + 0.5) * inverse_step, 0.0), 1e6))
        if tries > 8:
            level = (low + high) >> 1
        level = min(max(level, low + 1), high - 1)
        f, density = cumulative(mix, n, level * step - 0.5)
        end = level + int(min(f, 1.0) * (TOTAL - levels))
        if end <= target:
            low, low_end = level, end
        else:
            high, high_end = level, end
        # Newton towards the middle of the target, kept at least half a level beyond this edge.
        move = ((target + 0.5) - end) / (density * (TOTAL - levels) + inverse_step)
        x = level * step - 0.5 + move
    return low, low_end, high_end
