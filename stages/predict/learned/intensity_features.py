"""Features of one return's intensity: neighbours' intensities and the whole sweep's ranges.

Ranges are coded first, so ranges of the returns to the right and below are known too. Same exact
arithmetic and layout as :mod:`salpcc.stages.predict.learned.features`.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.predict.learned.features import LIMIT, SCALE, squash
from salpcc.stages.predict.learned.ring_rows import PAD

LEFT, UPPER, SECOND, RIGHT, BELOW = 6, 8, 4, 3, 4
SLOTS = LEFT + UPPER + SECOND
INPUTS = 56

_ZERO, _HALF, _ONE = np.float32(0.0), np.float32(0.5), np.float32(1.0)
_UNIT = np.float32(1.0 / 16.0)
_PER_STEP = np.float32(1.0 / 12.5)
_SCALE, _LIMIT = np.float32(SCALE), np.float32(LIMIT)
_NONE = np.float32(25.0)
_GAP = np.float32(8.0)

F32 = NDArray[np.float32]
I32 = NDArray[np.int32]


@njit(cache=True, error_model="numpy", inline="always")
def intensity_features(
    i: int,
    m: int,
    azimuth: F32,
    inverse: F32,
    value: F32,
    has1: bool,
    frame1: F32,
    inverse1: F32,
    intensity1: F32,
    index1: I32,
    has2: bool,
    inverse2: F32,
    intensity2: F32,
    index2: I32,
    below: bool,
    inverse3: F32,
    index3: I32,
    quotient: np.float32,
    activity: np.float32,
    x: F32,
    work: F32,
) -> tuple[int, int, np.float32]:
    """Fill ``x`` (INPUTS,); returns the two nearest intensities (left, above) and the local mean.

    ``value`` are the current ring's intensities (known left of i), 1 and 2 the rings above, 3 the ring
    below (ranges only). ``work`` is scratch, (3 * SLOTS,).
    """
    c = PAD + i
    w0 = inverse[c]
    a = azimuth[c]
    per_w = quotient / (w0 * w0) * _UNIT
    n_left = min(i, LEFT)
    o = c - LEFT
    for k in range(LEFT):
        work[k] = value[np.uint64(o + k)]
        work[SLOTS + k] = (inverse[np.uint64(o + k)] - w0) * per_w
        work[2 * SLOTS + k] = _ONE
    for k in range(LEFT - n_left):
        work[k] = _NONE
        work[SLOTS + k] = _GAP
        work[2 * SLOTS + k] = _ZERO
    j1 = index1[i]
    j2 = index2[i]
    if has1:
        o = j1 - UPPER // 2 + 1
        for k in range(UPPER):
            work[LEFT + k] = intensity1[np.uint64(o + k)]
            work[SLOTS + LEFT + k] = (inverse1[np.uint64(o + k)] - w0) * per_w
            work[2 * SLOTS + LEFT + k] = _HALF
        work[2 * SLOTS + LEFT + UPPER // 2 - 1] = _ONE
        work[2 * SLOTS + LEFT + UPPER // 2] = _ONE
    else:
        for k in range(UPPER):
            work[LEFT + k] = _NONE
            work[SLOTS + LEFT + k] = _GAP
            work[2 * SLOTS + LEFT + k] = _ZERO
    if has2:
        o = j2 - SECOND // 2 + 1
        for k in range(SECOND):
            work[LEFT + UPPER + k] = intensity2[np.uint64(o + k)]
            work[SLOTS + LEFT + UPPER + k] = (inverse2[np.uint64(o + k)] - w0) * per_w
            work[2 * SLOTS + LEFT + UPPER + k] = _HALF
    else:
        for k in range(SECOND):
            work[LEFT + UPPER + k] = _NONE
            work[SLOTS + LEFT + UPPER + k] = _GAP
            work[2 * SLOTS + LEFT + UPPER + k] = _ZERO
    total, first = np.float32(1e-3), np.float32(1e-3) * _NONE
    for k in range(SLOTS):
        q = work[SLOTS + k] * np.float32(0.5)
        weight = work[2 * SLOTS + k] / (_ONE + q * q)
        work[2 * SLOTS + k] = weight
        total += weight
        first += weight * work[k]
    mean = first / total
    spread = _ZERO
    for k in range(SLOTS):
        spread += work[2 * SLOTS + k] * abs(work[k] - mean)
    spread = spread / total
    for k in range(SLOTS):
        x[k] = work[SLOTS + k]
    o = SLOTS
    for k in range(RIGHT):
        x[o + k] = (inverse[np.uint64(c + 1 + k)] - w0) * per_w
    o += RIGHT
    if below:
        j3 = index3[i]
        f = j3 - BELOW // 2 + 1
        for k in range(BELOW):
            x[o + k] = (inverse3[np.uint64(f + k)] - w0) * per_w
    else:
        for k in range(BELOW):
            x[o + k] = _GAP
    o += BELOW
    x[o] = (a - azimuth[c - 1]) * _HALF - _ONE if i > 0 else _GAP
    x[o + 1] = (azimuth[c + 1] - a) * _HALF - _ONE if i + 1 < m else _GAP
    x[o + 2] = (a - frame1[j1]) * _HALF if has1 else _GAP
    x[o + 3] = (frame1[j1 + 1] - a) * _HALF if has1 else _GAP
    squash(x, o + 4)
    o += 4
    for k in range(SLOTS):
        x[o + k] = work[k] * _PER_STEP
    o += SLOTS
    x[o] = mean * _PER_STEP
    x[o + 1] = spread * _PER_STEP * np.float32(2.0)
    x[o + 2] = activity * _PER_STEP * np.float32(2.0)
    x[o + 3] = np.sqrt(_ONE / w0) * _HALF
    x[o + 4] = np.sqrt(w0) * np.float32(4.0)
    x[o + 5] = _ONE if has1 else _ZERO
    x[o + 6] = total * np.float32(0.25)
    x[o + 7] = np.float32(n_left) * np.float32(0.125)
    x[o + 8] = _ONE if has2 else _ZERO
    for k in range(INPUTS):
        x[k] = min(max(np.floor(x[k] * _SCALE + _HALF), -_LIMIT), _LIMIT)
    left = int(work[LEFT - 1])
    above = int(work[LEFT + UPPER // 2 - 1])
    if has1 and frame1[j1 + 1] - a < a - frame1[j1]:
        above = int(work[LEFT + UPPER // 2])
    return left, above, mean
