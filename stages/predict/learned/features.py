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

PAD = 8
PREDICTORS = 10
LEFT, UPPER, SECOND = 8, 10, 6
SLOTS = 24
INPUTS = 72
SCALE = 128.0  # one unit of a feature, in steps of the integer network
LIMIT = 1023.0

WORK = 168  # scratch of point_features, float32
_U, _UU, _D, _UD, _P, _W, _Q = 0, 24, 48, 72, 96, 120, 144

_TICKS = np.float32(4000.0)
_TICKS_PER_RADIAN = np.float32(636.6197723675814)
_NEAR, _FAR = np.float32(2.0), np.float32(1.0 / 125.0)  # bounds of a predicted inverse range, 1/m
_ZERO, _HALF, _ONE, _TWO = np.float32(0.0), np.float32(0.5), np.float32(1.0), np.float32(2.0)
_UNIT = np.float32(1.0 / 16.0)  # of a difference, per count
_SCALE, _LIMIT = np.float32(SCALE), np.float32(LIMIT)
_SLOT_DECAY = np.float32(1.0 / 16.0)
_GAP = np.float32(8.0)
_EDGE, _SPAN = np.float32(0.06), np.float32(16.0)
_WIDE, _TIGHT = np.float32(0.02), np.float32(0.001)  # tolerances of the planes, of the inverse range
_WIDE_UP = np.float32(0.05)
_NOISE = np.float32(0.02)  # and of its square, m
_RIDGE_U, _RIDGE_V = np.float32(0.02), np.float32(0.005)
_TINY = np.float32(1e-9)
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
def close_ring(azimuth: F32, inverse: F32, error: F32, n: int) -> None:
    """Fill the cyclic margins of a coded ring that stands at ``[PAD, PAD + n)``; n at least 1."""
    for p in range(PAD):
        left = PAD + n - 1 - p % n
        right = PAD + p % n
        turns = np.float32(1 + p // n) * _TICKS
        azimuth[PAD - 1 - p] = azimuth[left] - turns
        inverse[PAD - 1 - p] = inverse[left]
        azimuth[PAD + n + p] = azimuth[right] + turns
        inverse[PAD + n + p] = inverse[right]
        error[PAD - 1 - p] = error[PAD]
        error[PAD + n + p] = error[PAD + n - 1]


@njit(cache=True, error_model="numpy")
def align(
    azimuth: F32,
    inverse: F32,
    n: int,
    lever: np.float32,
    current: F32,
    m: int,
    frame: F32,
    index: I32,
    value: F32,
) -> None:
    """Move a coded ring into the frame of the current one and interpolate it at the current azimuths.

    ``lever`` is the difference of the two lever arms in metres. Fills ``frame`` (azimuths of the ring,
    margins included), and for each of the ``m`` current azimuths ``index`` (the last return of the
    ring not after it) and ``value`` (inverse range there: linear, or the nearer one across an edge).
    """
    shift = lever * _TICKS_PER_RADIAN
    for i in range(n + 2 * PAD):
        frame[i] = azimuth[i] + shift * inverse[i]
    j = PAD - 1
    last = PAD + n - 1
    for i in range(m):
        a = current[PAD + i]
        while j < last and frame[j + 1] <= a:
            j += 1
        index[i] = j
        span = frame[j + 1] - frame[j]
        t = (a - frame[j]) / span if span > _ZERO else _ZERO
        t = min(max(t, _ZERO), _ONE)
        difference = inverse[j + 1] - inverse[j]
        if abs(difference) > _EDGE * inverse[j] or span > _SPAN:
            value[i] = inverse[j + 1] if t > _HALF else inverse[j]
        else:
            value[i] = inverse[j] + t * difference


@njit(cache=True, error_model="numpy")
def _sums(work: F32, start: int, n: int) -> tuple[np.float32, np.float32, np.float32, np.float32, np.float32]:
    """Weighted sums of 1, U, U^2, D, U D over the slots of one ring."""
    s0, s1, s2, s3, s4 = _ZERO, _ZERO, _ZERO, _ZERO, _ZERO
    for k in range(start, start + n):
        weight = work[_W + k]
        s0 += weight
        s1 += weight * work[_U + k]
        s2 += weight * work[_UU + k]
        s3 += weight * work[_D + k]
        s4 += weight * work[_UD + k]
    return s0, s1, s2, s3, s4


@njit(cache=True, error_model="numpy")
def _plane(work: F32, v: np.float32) -> tuple[np.float32, np.float32, np.float32, np.float32]:
    """Fit ``D = a + b U + c V`` by least squares with weights W and a little ridge.

    V is 0 on the current ring, 1 on the one above, ``v`` on the next. Returns a, b, c, sum of weights.
    """
    l0, l1, l2, l3, l4 = _sums(work, 0, LEFT)
    m0, m1, m2, m3, m4 = _sums(work, LEFT, UPPER)
    n0, n1, n2, n3, n4 = _sums(work, LEFT + UPPER, SECOND)
    n0v = n0 * v
    s = (l0 + m0) + n0
    su = (l1 + m1) + n1
    sv = m0 + n0v
    sd = (l3 + m3) + n3
    per = _ONE / (s + _TINY)
    mu = su * per
    mv = sv * per
    md = sd * per
    uu = (l2 + m2) + n2 - su * mu + _RIDGE_U
    uv = m1 + n1 * v - su * mv
    vv = m0 + n0v * v - sv * mv + _RIDGE_V
    ud = (l4 + m4) + n4 - su * md
    vd = m3 + n3 * v - sv * md
    det = _ONE / max(uu * vv - uv * uv, _TINY)
    slope_u = (ud * vv - vd * uv) * det
    slope_v = (vd * uu - ud * uv) * det
    return md - slope_u * mu - slope_v * mv, slope_u, slope_v, s


@njit(cache=True, error_model="numpy")
def _weigh(work: F32, source: int, centre: np.float32, tolerance: np.float32) -> None:
    """Weights of the slots: position weight over (1 + q^2)^2, q = (source - centre) / tolerance."""
    for k in range(SLOTS):
        q = (work[source + k] - centre) * tolerance
        q = _ONE + q * q
        work[_W + k] = work[_P + k] / (q * q)


@njit(cache=True, error_model="numpy")
def _refit(
    work: F32, v: np.float32, a: np.float32, b: np.float32, c: np.float32, tolerance: np.float32
) -> tuple[np.float32, np.float32, np.float32, np.float32]:
    """Fit the plane again with weights from the distances to the plane (a, b, c)."""
    for k in range(LEFT):
        work[_Q + k] = work[_D + k] - (a + b * work[_U + k])
    for k in range(LEFT, LEFT + UPPER):
        work[_Q + k] = work[_D + k] - ((a + c) + b * work[_U + k])
    for k in range(LEFT + UPPER, SLOTS):
        work[_Q + k] = work[_D + k] - ((a + c * v) + b * work[_U + k])
    _weigh(work, _Q, _ZERO, tolerance)
    return _plane(work, v)


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
        work[_U + k] = u
        d = inverse[np.uint64(o + k)] - w1
        work[_D + k] = d
        work[_P + k] = _ONE
    for k in range(LEFT - n_left):
        work[_D + k] = _ZERO
        work[_P + k] = _ZERO
    j1 = index1[i]
    if has1:
        o = j1 - UPPER // 2 + 1
        for k in range(UPPER):
            u = (frame1[np.uint64(o + k)] - a) * _HALF
            d = inverse1[np.uint64(o + k)] - w1
            work[_U + LEFT + k] = u
            work[_D + LEFT + k] = d
            work[_P + LEFT + k] = _ONE
    else:
        for k in range(UPPER):
            work[_U + LEFT + k] = _ZERO
            work[_D + LEFT + k] = _ZERO
            work[_P + LEFT + k] = _ZERO
    j2 = index2[i]
    if has2:
        o = j2 - SECOND // 2 + 1
        for k in range(SECOND):
            u = (frame2[np.uint64(o + k)] - a) * _HALF
            d = inverse2[np.uint64(o + k)] - w1
            work[_U + LEFT + UPPER + k] = u
            work[_D + LEFT + UPPER + k] = d
            work[_P + LEFT + UPPER + k] = _HALF
    else:
        for k in range(SECOND):
            work[_U + LEFT + UPPER + k] = _ZERO
            work[_D + LEFT + UPPER + k] = _ZERO
            work[_P + LEFT + UPPER + k] = _ZERO

    for k in range(SLOTS):
        uu = work[_U + k] * work[_U + k]
        work[_UU + k] = uu
        work[_UD + k] = work[_U + k] * work[_D + k]
        work[_P + k] = work[_P + k] / (_ONE + uu * _SLOT_DECAY)
    noise = _NOISE * w1 * w1
    tight = _ONE / (_TIGHT * w1 + noise)
    _weigh(work, _D, shift1, _ONE / (_WIDE_UP * w1 + noise))
    plane_up, _, _, sum_up = _plane(work, height2)
    _weigh(work, _D, _ZERO, _ONE / (_WIDE * w1 + noise))
    plane_left, b, g, sum_left = _plane(work, height2)
    plane_tight, slope_u, slope_v, sum_tight = _refit(work, height2, plane_left, b, g, tight)
    base = min(max(w1 + plane_tight, _FAR), _NEAR)

    mu[0] = w1
    mu[1] = w1
    mu[2] = w1
    mu[3] = up
    mu[4] = w1
    mu[6] = up
    if n_left >= 2:
        span = max(azimuth[c - 1] - azimuth[c - 2], _ONE)
        mu[1] = w1 - work[_D + LEFT - 2] * ((a - azimuth[c - 1]) / span)
    mu[5] = up + (up - second) / max(height2 - _ONE, np.float32(0.25))
    if n_left >= 4:
        mu[2] = w1 + (work[_D + LEFT - 2] - work[_D + LEFT - 4]) * _HALF
    if n_left >= 1 and has1:
        mu[4] = w1 + (up - value1[i - 1])
    if n_left >= 4 and has1:
        g = (work[_D + LEFT - 2] + work[_D + LEFT - 3]) + work[_D + LEFT - 4]
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
        r = (work[_D + k] - (plane_tight + slope_u * work[_U + k])) * per_w
        x[o + k] = r if work[_P + k] > _ZERO else _ZERO
    for k in range(LEFT, LEFT + UPPER):
        r = (work[_D + k] - ((plane_tight + slope_v) + slope_u * work[_U + k])) * per_w
        x[o + k] = r if work[_P + k] > _ZERO else _ZERO
    for k in range(LEFT + UPPER, SLOTS):
        r = (work[_D + k] - ((plane_tight + slope_v * height2) + slope_u * work[_U + k])) * per_w
        x[o + k] = r if work[_P + k] > _ZERO else _ZERO
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
