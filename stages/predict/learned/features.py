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
PREDICTORS = 11
LEFT, UPPER, SECOND = 8, 10, 6
SLOTS = 24
PAIRS = 2 * PREDICTORS + PREDICTORS  # differences, errors at the left, errors above
INPUTS = 72
SCALE = 128.0  # one unit of a feature, in steps of the integer network
LIMIT = 1023.0

_TICKS = 4000.0
_TICKS_PER_RADIAN = 636.6197723675814
_NEAR, _FAR = 2.0, 1.0 / 125.0  # largest and smallest inverse range of a prediction, 1/m


@njit(cache=True, error_model="numpy")
def squash(x: NDArray[np.float32], n: int) -> None:
    """Compress x[:n] in place: odd, linear near 0, growing like the fourth root."""
    one = np.float32(1.0)
    for i in range(n):
        a = x[i] / np.sqrt(one + abs(x[i]))
        x[i] = a / np.sqrt(one + abs(a))


@njit(cache=True, error_model="numpy")
def close_ring(azimuth: NDArray[np.float64], inverse: NDArray[np.float64], n: int) -> None:
    """Fill the cyclic margins of a coded ring that stands at ``[PAD, PAD + n)``; n at least 1."""
    for p in range(PAD):
        left = n - 1 - p % n
        right = p % n
        azimuth[PAD - 1 - p] = azimuth[PAD + left] - _TICKS * (1 + p // n)
        inverse[PAD - 1 - p] = inverse[PAD + left]
        azimuth[PAD + n + p] = azimuth[PAD + right] + _TICKS * (1 + p // n)
        inverse[PAD + n + p] = inverse[PAD + right]


@njit(cache=True, error_model="numpy")
def align(
    azimuth: NDArray[np.float64],
    inverse: NDArray[np.float64],
    n: int,
    lever: float,
    start: NDArray[np.float64],
    m: int,
    frame: NDArray[np.float64],
    index: NDArray[np.int32],
    value: NDArray[np.float64],
) -> None:
    """Move a coded ring into the frame of the current one and interpolate it at the current azimuths.

    ``lever`` is the difference of the two lever arms in metres. Fills ``frame`` (azimuths of the ring,
    margins included), and for each of the ``m`` current azimuths ``index`` (the last return of the
    ring not after it) and ``value`` (inverse range there: linear, or the nearer one across an edge).
    """
    for i in range(n + 2 * PAD):
        frame[i] = azimuth[i] + lever * inverse[i] * _TICKS_PER_RADIAN
    j = PAD - 1
    last = PAD + n - 1
    for i in range(m):
        a = start[PAD + i]
        while j < last and frame[j + 1] <= a:
            j += 1
        index[i] = j
        span = frame[j + 1] - frame[j]
        t = (a - frame[j]) / span if span > 0.0 else 0.0
        t = min(max(t, 0.0), 1.0)
        difference = inverse[j + 1] - inverse[j]
        if abs(difference) > 0.06 * inverse[j] or span > 16.0:
            value[i] = inverse[j + 1] if t > 0.5 else inverse[j]
        else:
            value[i] = inverse[j] + t * difference


@njit(cache=True, error_model="numpy")
def _plane(
    weight: NDArray[np.float32],
    dw: NDArray[np.float32],
    u: NDArray[np.float32],
    v: NDArray[np.float32],
    lanes: NDArray[np.float32],
    fit: NDArray[np.float32],
) -> None:
    """Fit ``dw = a + b u + c v`` by weighted least squares with a little ridge; fills fit = (a, b, c)."""
    for k in range(8):
        s0 = weight[k]
        s1 = s0 * u[k]
        s2 = s0 * v[k]
        lanes[0, k] = s0
        lanes[1, k] = s1
        lanes[2, k] = s2
        lanes[3, k] = s1 * u[k]
        lanes[4, k] = s1 * v[k]
        lanes[5, k] = s2 * v[k]
        lanes[6, k] = s0 * dw[k]
        lanes[7, k] = s1 * dw[k]
        lanes[8, k] = s2 * dw[k]
    for b in range(8, SLOTS, 8):
        for k in range(8):
            s0 = weight[b + k]
            s1 = s0 * u[b + k]
            s2 = s0 * v[b + k]
            lanes[0, k] += s0
            lanes[1, k] += s1
            lanes[2, k] += s2
            lanes[3, k] += s1 * u[b + k]
            lanes[4, k] += s1 * v[b + k]
            lanes[5, k] += s2 * v[b + k]
            lanes[6, k] += s0 * dw[b + k]
            lanes[7, k] += s1 * dw[b + k]
            lanes[8, k] += s2 * dw[b + k]
    for r in range(9):
        a0 = lanes[r, 0] + lanes[r, 4]
        a1 = lanes[r, 1] + lanes[r, 5]
        a2 = lanes[r, 2] + lanes[r, 6]
        a3 = lanes[r, 3] + lanes[r, 7]
        lanes[r, 0] = (a0 + a2) + (a1 + a3)
    n = np.float64(lanes[0, 0]) + 1e-9
    mu = lanes[1, 0] / n
    mv = lanes[2, 0] / n
    md = lanes[6, 0] / n
    ridge = 0.02
    uu = lanes[3, 0] - n * mu * mu + ridge * 4.0
    uv = lanes[4, 0] - n * mu * mv
    vv = lanes[5, 0] - n * mv * mv + ridge
    ud = lanes[7, 0] - n * mu * md
    vd = lanes[8, 0] - n * mv * md
    det = uu * vv - uv * uv
    if det < 1e-9:
        det = 1e-9
    slope_u = (ud * vv - vd * uv) / det
    slope_v = (vd * uu - ud * uv) / det
    fit[0] = md - slope_u * mu - slope_v * mv
    fit[1] = slope_u
    fit[2] = slope_v


@njit(cache=True, error_model="numpy")
def point_features(
    i: int,
    m: int,
    azimuth: NDArray[np.float64],
    inverse: NDArray[np.float64],
    frame1: NDArray[np.float64],
    inverse1: NDArray[np.float64],
    error1: NDArray[np.float32],
    index1: NDArray[np.int32],
    value1: NDArray[np.float64],
    has1: bool,
    frame2: NDArray[np.float64],
    inverse2: NDArray[np.float64],
    index2: NDArray[np.int32],
    value2: NDArray[np.float64],
    has2: bool,
    height2: float,
    quotient: float,
    offset: float,
    step_feature: float,
    error0: NDArray[np.float32],
    work: NDArray[np.float32],
    x: NDArray[np.float32],
    mu: NDArray[np.float64],
) -> None:
    """Fill the features ``x`` (INPUTS,) and the predicted range counts ``mu`` (PREDICTORS,) of return i.

    Rings stand at ``[PAD, PAD + n)``; 1 is the ring above, 2 the one above that. ``height2`` is the
    second ring's elevation step in units of the first's. ``quotient / w - offset`` are counts.
    ``error0`` are the running squashed errors of the predictors to the left, ``error1`` those at each
    return above. ``work`` is scratch, (32, SLOTS).
    """
    c = PAD + i
    a = azimuth[c]
    n_left = min(i, LEFT)
    if n_left > 0:
        w1 = inverse[c - 1]
    elif has1:
        w1 = value1[i]
    else:
        w1 = 0.05
    up = value1[i] if has1 else w1
    second = value2[i] if has2 else up

    u, v, dw, position = work[0], work[1], work[2], work[3]
    weight, own, residual = work[4], work[5], work[6]
    lanes = work[8:17]
    fit = work[17]
    half = np.float32(0.5)
    one = np.float32(1.0)
    for k in range(SLOTS):
        position[k] = 0.0
        u[k] = 0.0
        v[k] = 0.0
        dw[k] = 0.0
        own[k] = 0.0
    for k in range(n_left):
        u[k] = (azimuth[c - 1 - k] - a) * 0.5
        dw[k] = inverse[c - 1 - k] - w1
        own[k] = dw[k]
        position[k] = one
    shift1 = np.float32(up - w1)
    shift2 = np.float32(second - w1)
    if has1:
        j = index1[i] - UPPER // 2 + 1
        for k in range(UPPER):
            u[LEFT + k] = (frame1[j + k] - a) * 0.5
            v[LEFT + k] = one
            dw[LEFT + k] = inverse1[j + k] - w1
            own[LEFT + k] = inverse1[j + k] - up
            position[LEFT + k] = one
    if has2:
        j = index2[i] - SECOND // 2 + 1
        for k in range(SECOND):
            b = LEFT + UPPER + k
            u[b] = (frame2[j + k] - a) * 0.5
            v[b] = height2
            dw[b] = inverse2[j + k] - w1
            own[b] = inverse2[j + k] - second
            position[b] = half
    ninth = np.float32(1.0 / 9.0)
    for k in range(SLOTS):
        position[k] = position[k] / (one + u[k] * u[k] * ninth)

    tolerance = np.float32(1.0 / (0.03 * w1 + 0.03 * w1 * w1))
    for k in range(SLOTS):
        q = dw[k] * tolerance
        q = one + q * q
        weight[k] = position[k] / (q * q)
    _plane(weight, dw, u, v, lanes, fit)
    plane_left = w1 + fit[0]
    for k in range(SLOTS):
        q = (dw[k] - shift1) * tolerance
        q = one + q * q
        weight[k] = position[k] / (q * q)
    _plane(weight, dw, u, v, lanes, fit)
    plane_up = w1 + fit[0]
    for k in range(SLOTS):
        q = own[k] * tolerance
        q = one + q * q
        weight[k] = position[k] / (q * q)
    _plane(weight, dw, u, v, lanes, fit)
    plane_own = w1 + fit[0]
    tight = np.float32(1.0 / (0.004 * w1 + 0.03 * w1 * w1))
    for k in range(SLOTS):
        q = (dw[k] - (fit[0] + fit[1] * u[k] + fit[2] * v[k])) * tight
        q = one + q * q
        weight[k] = position[k] / (q * q)
    _plane(weight, dw, u, v, lanes, fit)
    base = w1 + np.float64(fit[0])
    base = min(max(base, _FAR), _NEAR)

    mu[0] = w1
    mu[1] = w1
    mu[2] = w1
    mu[6] = up
    if n_left >= 2:
        span = azimuth[c - 1] - azimuth[c - 2]
        mu[1] = w1 + (w1 - inverse[c - 2]) * ((a - azimuth[c - 1]) / max(span, 1.0))
    if n_left >= 4:
        mu[2] = (2.0 * w1 + inverse[c - 2] - inverse[c - 4]) * 0.5
    mu[3] = up
    mu[4] = w1
    if n_left >= 1 and has1:
        mu[4] = w1 + up - value1[i - 1]
    mu[5] = up + (up - second) / max(height2 - 1.0, 0.25)
    if n_left >= 4 and has1:
        g = (inverse[c - 1] - value1[i - 1]) + (inverse[c - 2] - value1[i - 2])
        g = g + (inverse[c - 3] - value1[i - 3]) + (inverse[c - 4] - value1[i - 4])
        mu[6] = up + 0.25 * g
    mu[7] = plane_left
    mu[8] = plane_up
    mu[9] = plane_own
    for p in range(PREDICTORS - 1):
        mu[p] = quotient / min(max(mu[p], _FAR), _NEAR) - offset
    centre = quotient / base - offset
    mu[PREDICTORS - 1] = centre

    # Differences in units of 16 counts; d(counts) = -quotient / base**2 dw near the base.
    unit = np.float32(1.0 / 16.0)
    for p in range(PREDICTORS - 1):
        x[p] = np.float32(mu[p] - centre) * unit
    per_w = np.float32(quotient / (base * base)) * unit
    o = PREDICTORS - 1
    for k in range(SLOTS):
        x[o + k] = (dw[k] - (fit[0] + fit[1] * u[k] + fit[2] * v[k])) * per_w
        if position[k] == 0.0:
            x[o + k] = 0.0
    o += SLOTS
    x[o] = fit[1] * per_w
    x[o + 1] = fit[2] * per_w
    gap = np.float32(8.0)
    x[o + 2] = (a - azimuth[c - 1]) * half - one if n_left > 0 else gap
    x[o + 3] = (azimuth[c + 1] - a) * half - one if i + 1 < m else np.float32(0.0)
    x[o + 4] = (a - frame1[index1[i]]) * half if has1 else gap
    x[o + 5] = (frame1[index1[i] + 1] - a) * half if has1 else gap
    x[o + 6] = (frame2[index2[i] + 1] - frame2[index2[i]]) * half - one if has2 else gap
    x[o + 7] = shift1 * per_w
    x[o + 8] = (azimuth[c + 2] - azimuth[c + 1]) * half - one if i + 2 < m else np.float32(0.0)
    squash(x, o + 9)
    o += 9
    for p in range(PREDICTORS):
        x[o + p] = error0[p]
    o += PREDICTORS
    if has1:
        j = index1[i]
        for p in range(PREDICTORS):
            x[o + p] = half * (error1[j, p] + error1[j + 1, p])
    else:
        for p in range(PREDICTORS):
            x[o + p] = one + half
    o += PREDICTORS
    x[o] = np.float32(n_left) * np.float32(0.125)
    x[o + 1] = one if has1 else np.float32(0.0)
    x[o + 2] = one if has2 else np.float32(0.0)
    x[o + 3] = np.float32(np.sqrt(1.0 / base)) * half
    x[o + 4] = np.float32(np.sqrt(base)) * np.float32(4.0)
    x[o + 5] = step_feature
    x[o + 6] = lanes[0, 0] * np.float32(0.25)
    limit = np.float32(LIMIT)
    scale = np.float32(SCALE)
    for k in range(INPUTS):
        x[k] = min(max(np.floor(x[k] * scale + half), -limit), limit)


@njit(cache=True, error_model="numpy")
def note_errors(
    actual: float, mu: NDArray[np.float64], i: int, error0: NDArray[np.float32], error: NDArray[np.float32]
) -> None:
    """Record how far each predictor was from ``actual`` counts, for the features of later returns."""
    unit = 1.0 / 16.0
    row = error[PAD + i]
    for p in range(PREDICTORS):
        row[p] = abs(mu[p] - actual) * unit
    squash(row, PREDICTORS)
    half = np.float32(0.5)
    for p in range(PREDICTORS):
        error0[p] = half * (error0[p] + row[p])
