"""What the sweep before says about one return: three more predictors and their features, and intensities.

Effort ``max`` only. The layout and the exact arithmetic are those of :mod:`.features`; slots are the points of
three rows of the :mod:`warped sweep <.previous_sweep>` around the return, on its own row, the one above and the
one below.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.predict.learned.features import LIMIT, SCALE

OWN, NEXT = 6, 4
SLOTS = OWN + 2 * NEXT
INPUTS = 32  # more than those of features
PREDICTORS = 3
INTENSITY_INPUTS = 24
NO_VALUE = 101  # row of the table of intensities where there is no sweep before

_ZERO, _HALF, _ONE, _TWO = np.float32(0.0), np.float32(0.5), np.float32(1.0), np.float32(2.0)
_UNIT = np.float32(1.0 / 16.0)
_SCALE, _LIMIT = np.float32(SCALE), np.float32(LIMIT)
_NEAR, _FAR = np.float32(2.0), np.float32(1.0 / 125.0)
_SPREAD = np.float32(0.3)  # of the weights: squared firings
_ROW = np.float32(4.0)  # a row is two firings apart
_GAP = np.float32(8.0)
_NONE = np.float32(25.0)
_PER_STEP = np.float32(1.0 / 12.5)
_TINY = np.float32(1e-6)
_NO_ERROR = np.float32(1.5)

F32 = NDArray[np.float32]
I32 = NDArray[np.int32]


@njit(cache=True, error_model="numpy")
def gather(i, k, a, frames, indices, number, inverse, height, intensity, z0, tangent, spacing, slot, values):  # type: ignore[no-untyped-def]
    """Fill ``slot`` (4, SLOTS) with U, V, inverse range and weight of the points around return i of ring k.

    U in firings (two ticks), V in rows; weight 0 where there is no point. ``frames`` and ``indices``
    are the rows k - 1, k, k + 1, aligned.
    """
    s = 0
    for r in range(3):
        row = k - 1 + r
        n = OWN if r == 1 else NEXT
        if row < 0 or row >= len(number) or number[row] == 0:
            for c in range(n):
                slot[0, s + c] = _ZERO
                slot[1, s + c] = _ZERO
                slot[2, s + c] = _ONE
                slot[3, s + c] = _ZERO
                values[s + c] = _NONE
        else:
            o = indices[r, i] - n // 2 + 1
            for c in range(n):
                u = (frames[r, np.uint64(o + c)] - a) * _HALF
                w = inverse[row, np.uint64(o + c)]
                v = (height[row, np.uint64(o + c)] - z0 * w - tangent) * spacing
                slot[0, s + c] = u
                slot[1, s + c] = v
                slot[2, s + c] = w
                values[s + c] = intensity[row, np.uint64(o + c)]
                q = u * u + _ROW * (v * v) + _SPREAD
                slot[3, s + c] = _ONE / (q * q)
        s += n


@njit(cache=True, error_model="numpy")
def previous_features(  # type: ignore[no-untyped-def]
    w1, tight, slope_u, slope_v, base, quotient, offset, slot, signed, error0, error1, j1, has1, x, mu
):
    """Append ``x[-INPUTS:]`` and ``mu[-PREDICTORS:]``.

    Residuals are those of the slots to the base plane of :func:`features.point_features`, in units of 16 counts. The
    predictors: the base plane moved by the residuals' mean, weighted by nearness; the same, robust; the first,
    moved by its own error at the return to the left, ``signed[0]``.
    """
    o = len(x) - INPUTS
    p = len(mu) - PREDICTORS
    per_w = quotient / (base * base) * _UNIT
    total, near_sum, robust, robust_sum = _TINY, _ZERO, _TINY, _ZERO
    for s in range(SLOTS):
        weight = slot[3, s]
        r = ((slot[2, s] - w1) - ((tight + slope_v * slot[1, s]) + slope_u * slot[0, s])) * per_w
        if weight == _ZERO:
            r = _ZERO
        x[o + s] = r
        total += weight
        near_sum += weight * r
        q = _ONE + r * r
        weight = weight / (q * q)
        robust += weight
        robust_sum += weight * r
    near = near_sum / total
    spread = _ZERO
    for s in range(SLOTS):
        spread += slot[3, s] * abs(x[o + s] - near)
    centre = mu[p - 1]
    slope = _ONE / per_w
    mu[p] = quotient / min(max(base + near * slope, _FAR), _NEAR) - offset
    mu[p + 1] = quotient / min(max(base + robust_sum / robust * slope, _FAR), _NEAR) - offset
    mu[p + 2] = mu[p] + signed[0]
    o += SLOTS
    there = slot[3, NEXT] > _ZERO
    x[o] = (mu[p] - centre) * _UNIT
    x[o + 1] = (mu[p + 1] - centre) * _UNIT
    x[o + 2] = signed[0] * _UNIT
    x[o + 3] = slot[0, NEXT + OWN // 2 - 1] if there else -_GAP
    x[o + 4] = slot[0, NEXT + OWN // 2] if there else _GAP
    x[o + 5] = slot[1, NEXT + OWN // 2 - 1]
    x[o + 6] = slot[1, NEXT + OWN // 2]
    x[o + 7] = spread / total
    for c in range(len(x) - INPUTS, o + 8):
        b = x[c] / np.sqrt(_ONE + abs(x[c]))
        x[c] = b / np.sqrt(_ONE + abs(b))
    o += 8
    for c in range(PREDICTORS):
        x[o + c] = error0[p + c]
        x[o + PREDICTORS + c] = _HALF * (error1[j1, p + c] + error1[j1 + 1, p + c]) if has1 else _NO_ERROR
    o += 2 * PREDICTORS
    x[o] = total / (_ONE + total)
    x[o + 1] = robust / (_ONE + total)
    x[o + 2] = _ONE if there else _ZERO
    x[o + 3] = _ZERO
    for c in range(len(x) - INPUTS, len(x)):
        x[c] = min(max(np.floor(x[c] * _SCALE + _HALF), -_LIMIT), _LIMIT)


@njit(cache=True, error_model="numpy")
def previous_intensity(w0, quotient, slot, values, activity, bias, x):  # type: ignore[no-untyped-def]
    """Append ``x[-INTENSITY_INPUTS:]``; ``values`` (SLOTS,) are the slots' intensities.

    Returns the intensity of the nearest slot, in azimuth, elevation and range together, and the
    weighted mean.
    """
    o = len(x) - INTENSITY_INPUTS
    per_w = quotient / (w0 * w0) * _UNIT
    total, first = np.float32(1e-3), np.float32(1e-3) * _NONE
    most, best = _ZERO, NO_VALUE
    c = 0
    for s in range(SLOTS):
        r = (slot[2, s] - w0) * per_w
        q = r * _HALF
        weight = slot[3, s] / (_ONE + q * q)
        total += weight
        first += weight * values[s]
        if weight > most:
            most = weight
            best = int(values[s])
        slot[3, s] = weight
        if (
            (s >= 1 and s < 3)
            or (s >= NEXT + 1 and s < NEXT + 5)
            or (s >= NEXT + OWN + 1 and s < NEXT + OWN + 3)
        ):
            x[o + c] = r if weight > _ZERO else _GAP
            x[o + 8 + c] = values[s] * _PER_STEP
            c += 1
    mean = first / total
    spread = _ZERO
    for s in range(SLOTS):
        spread += slot[3, s] * abs(values[s] - mean)
    for c in range(8):
        b = x[o + c] / np.sqrt(_ONE + abs(x[o + c]))
        x[o + c] = b / np.sqrt(_ONE + abs(b))
    o += 16
    x[o] = mean * _PER_STEP
    x[o + 1] = spread / total * _PER_STEP * _TWO
    x[o + 2] = activity * _PER_STEP * _TWO
    x[o + 3] = bias * _PER_STEP * _TWO
    x[o + 4] = total / (_ONE + total)
    x[o + 5] = _ONE if slot[3, NEXT] > _ZERO else _ZERO
    x[o + 6] = most / (_ONE + most)
    x[o + 7] = _ZERO
    for c in range(len(x) - INTENSITY_INPUTS, len(x)):
        x[c] = min(max(np.floor(x[c] * _SCALE + _HALF), -_LIMIT), _LIMIT)
    return best, mean
