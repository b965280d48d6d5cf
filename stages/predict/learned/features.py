"""Predictors and features of one return's range, from the returns coded before it.

Everything lives in inverse horizontal range ``w = 1 / rho'``, where a plane is linear in azimuth and
in the tangent of the elevation (SENSOR_LATTICE.md, section 3). Rings are coded top first, returns by
rising tick. The lever arm of SENSOR_LATTICE.md, section 1, shifts what a laser sees at a given tick,
so the rings above are first moved into the tick frame of the current laser.

The decoder repeats all of this, hence only float64 and float32 with ``+ - * /`` and square roots, in
a fixed order: the same bits on every machine (SENSOR_LATTICE.md, section 4).
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.predict.learned.local_plane import (
    LEFT,
    SECOND,
    SLOTS,
    UD,
    UPPER,
    UU,
    D,
    P,
    U,
    fit_plane,
    refit_plane,
    weigh,
)
from salpcc.stages.predict.learned.ring_rows import PAD

PREDICTORS = 10
INPUTS = 72
SCALE = 128.0  # one unit of a feature, in steps of the integer network
LIMIT = 1023.0

_NEAR, _FAR = np.float32(2.0), np.float32(1.0 / 125.0)  # bounds of a predicted inverse range, 1/m
_ZERO, _HALF, _ONE, _TWO = np.float32(0.0), np.float32(0.5), np.float32(1.0), np.float32(2.0)
_UNIT = np.float32(1.0 / 16.0)  # of a difference, per count
_SCALE, _LIMIT = np.float32(SCALE), np.float32(LIMIT)
_SLOT_DECAY = np.float32(1.0 / 16.0)
_GAP = np.float32(8.0)
_WIDE, _TIGHT = np.float32(0.02), np.float32(0.001)  # tolerances of the planes, of the inverse range
_WIDE_UP = np.float32(0.05)
_NOISE = np.float32(0.02)  # and of its square, m
_NO_ERROR = np.float32(1.5)

F32 = NDArray[np.float32]
I32 = NDArray[np.int32]


@njit(cache=True, error_model="numpy")
def squash(x: F32, n: int) -> None:
    """Compress x[:n] in place: odd, linear near 0, growing like the fourth root."""
    for i in range(n):
        a = x[i] / np.sqrt(_ONE + abs(x[i]))
        x[i] = a / np.sqrt(_ONE + abs(a))


@njit(cache=True, error_model="numpy")
def point_features(
    i: int,
    m: int,
    azimuth: F32,
    inverse: F32,
    frame1: F32,
    inverse1: F32,
    error1: F32,
    index1: I32,
    value1: F32,
    has1: bool,
    frame2: F32,
    inverse2: F32,
    index2: I32,
    value2: F32,
    has2: bool,
    height2: np.float32,
    quotient: np.float32,
    offset: np.float32,
    step: np.float32,
    error0: F32,
    work: F32,
    x: F32,
    mu: F32,
) -> tuple[np.float32, np.float32, np.float32, np.float32, np.float32]:
    """Fill the features ``x`` (INPUTS,) and the predicted range counts ``mu`` (PREDICTORS,) of return i.

    Rings stand at ``[PAD, PAD + n)``; 1 is the ring above, 2 the one above that. ``height2`` is the
    second ring's elevation step in units of the first's. ``quotient / w - offset`` are counts.
    ``error0`` are the running squashed errors of the predictors to the left, ``error1`` those at each
    return above. ``work`` is scratch, (WORK,).
    """
    c = PAD + i
    a = azimuth[c]
    n_left = min(i, LEFT)
    if n_left > 0:
        w1 = inverse[c - 1]
    elif has1:
        w1 = value1[i]
    else:
        w1 = np.float32(0.05)
    up = value1[i] if has1 else w1
    second = value2[i] if has2 else up
    shift1 = up - w1
    shift2 = second - w1
    o = c - LEFT
    for k in range(LEFT):
        u = (azimuth[np.uint64(o + k)] - a) * _HALF
        work[U + k] = u
        d = inverse[np.uint64(o + k)] - w1
        work[D + k] = d
        work[P + k] = _ONE
    for k in range(LEFT - n_left):
        work[D + k] = _ZERO
        work[P + k] = _ZERO
    j1 = index1[i]
    if has1:
        o = j1 - UPPER // 2 + 1
        for k in range(UPPER):
            u = (frame1[np.uint64(o + k)] - a) * _HALF
            d = inverse1[np.uint64(o + k)] - w1
            work[U + LEFT + k] = u
            work[D + LEFT + k] = d
            work[P + LEFT + k] = _ONE
    else:
        for k in range(UPPER):
            work[U + LEFT + k] = _ZERO
            work[D + LEFT + k] = _ZERO
            work[P + LEFT + k] = _ZERO
    j2 = index2[i]
    if has2:
        o = j2 - SECOND // 2 + 1
        for k in range(SECOND):
            u = (frame2[np.uint64(o + k)] - a) * _HALF
            d = inverse2[np.uint64(o + k)] - w1
            work[U + LEFT + UPPER + k] = u
            work[D + LEFT + UPPER + k] = d
            work[P + LEFT + UPPER + k] = _HALF
    else:
        for k in range(SECOND):
            work[U + LEFT + UPPER + k] = _ZERO
            work[D + LEFT + UPPER + k] = _ZERO
            work[P + LEFT + UPPER + k] = _ZERO

    for k in range(SLOTS):
        uu = work[U + k] * work[U + k]
        work[UU + k] = uu
        work[UD + k] = work[U + k] * work[D + k]
        work[P + k] = work[P + k] / (_ONE + uu * _SLOT_DECAY)
    noise = _NOISE * w1 * w1
    tight = _ONE / (_TIGHT * w1 + noise)
    weigh(work, D, shift1, _ONE / (_WIDE_UP * w1 + noise))
    plane_up, _, _, sum_up = fit_plane(work, height2)
    weigh(work, D, _ZERO, _ONE / (_WIDE * w1 + noise))
    plane_left, b, g, sum_left = fit_plane(work, height2)
    plane_tight, slope_u, slope_v, sum_tight = refit_plane(work, height2, plane_left, b, g, tight)
    base = min(max(w1 + plane_tight, _FAR), _NEAR)

    mu[0] = w1
    mu[1] = w1
    mu[2] = w1
    mu[3] = up
    mu[4] = w1
    mu[6] = up
    if n_left >= 2:
        span = max(azimuth[c - 1] - azimuth[c - 2], _ONE)
        mu[1] = w1 - work[D + LEFT - 2] * ((a - azimuth[c - 1]) / span)
    mu[5] = up + (up - second) / max(height2 - _ONE, np.float32(0.25))
    if n_left >= 4:
        mu[2] = w1 + (work[D + LEFT - 2] - work[D + LEFT - 4]) * _HALF
    if n_left >= 1 and has1:
        mu[4] = w1 + (up - value1[i - 1])
    if n_left >= 4 and has1:
        g = (work[D + LEFT - 2] + work[D + LEFT - 3]) + work[D + LEFT - 4]
        v = (value1[i - 1] + value1[i - 2]) + (value1[i - 3] + value1[i - 4])
        mu[6] = w1 + (up + (g - v) * np.float32(0.25))
    mu[7] = w1 + plane_up
    mu[8] = w1 + plane_left
    for p in range(PREDICTORS - 1):
        mu[p] = quotient / min(max(mu[p], _FAR), _NEAR) - offset
    centre = quotient / base - offset
    mu[PREDICTORS - 1] = centre

    for p in range(PREDICTORS - 1):
        x[p] = (mu[p] - centre) * _UNIT
    per_w = quotient / (base * base) * _UNIT  # counts fall by quotient / base^2 per unit of w
    o = PREDICTORS - 1
    for k in range(LEFT):
        r = (work[D + k] - (plane_tight + slope_u * work[U + k])) * per_w
        x[o + k] = r if work[P + k] > _ZERO else _ZERO
    for k in range(LEFT, LEFT + UPPER):
        r = (work[D + k] - ((plane_tight + slope_v) + slope_u * work[U + k])) * per_w
        x[o + k] = r if work[P + k] > _ZERO else _ZERO
    for k in range(LEFT + UPPER, SLOTS):
        r = (work[D + k] - ((plane_tight + slope_v * height2) + slope_u * work[U + k])) * per_w
        x[o + k] = r if work[P + k] > _ZERO else _ZERO
    o += SLOTS
    x[o] = slope_u * per_w
    x[o + 1] = slope_v * per_w
    x[o + 2] = (a - azimuth[c - 1]) * _HALF - _ONE if n_left > 0 else _GAP
    x[o + 3] = (azimuth[c + 1] - a) * _HALF - _ONE if i + 1 < m else _ZERO
    x[o + 4] = (a - frame1[j1]) * _HALF if has1 else _GAP
    x[o + 5] = (frame1[j1 + 1] - a) * _HALF if has1 else _GAP
    x[o + 6] = (frame2[j2 + 1] - frame2[j2]) * _HALF - _ONE if has2 else _GAP
    x[o + 7] = shift1 * per_w
    x[o + 8] = (azimuth[c + 2] - azimuth[c + 1]) * _HALF - _ONE if i + 2 < m else _ZERO
    x[o + 9] = shift2 * per_w
    squash(x, o + 10)
    o += 10
    for p in range(PREDICTORS):
        x[o + p] = error0[p]
    o += PREDICTORS
    if has1:
        for p in range(PREDICTORS):
            x[o + p] = _HALF * (error1[j1, p] + error1[j1 + 1, p])
    else:
        for p in range(PREDICTORS):
            x[o + p] = _NO_ERROR
    o += PREDICTORS
    x[o] = np.float32(n_left) * np.float32(0.125)
    x[o + 1] = _ONE if has1 else _ZERO
    x[o + 2] = _ONE if has2 else _ZERO
    x[o + 3] = np.sqrt(_ONE / base) * _HALF
    x[o + 4] = np.sqrt(base) * np.float32(4.0)
    x[o + 5] = step
    quarter = np.float32(0.25)
    x[o + 6] = sum_tight * quarter
    x[o + 7] = sum_left * quarter
    x[o + 8] = sum_up * quarter
    for k in range(INPUTS):
        x[k] = min(max(np.floor(x[k] * _SCALE + _HALF), -_LIMIT), _LIMIT)
    return w1, plane_tight, slope_u, slope_v, base


@njit(cache=True, error_model="numpy")
def note_errors(actual: np.float32, mu: F32, error0: F32, error: F32, place: int) -> None:
    """Record how far each predictor was from ``actual`` counts, for the features of later returns."""
    for p in range(len(mu)):
        e = abs(mu[p] - actual) * _UNIT
        e = e / np.sqrt(_ONE + e)
        e = e / np.sqrt(_ONE + e)
        error[np.uint64(place), p] = e
        error0[p] = _HALF * (error0[p] + e)
