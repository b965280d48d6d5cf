"""Neighbour predictors in 1/r and their adaptive mixture (SENSOR_LATTICE.md, section 3).

1/r is linear over a plane, so planes need no fitting: extrapolating 1/r from returns that are already
known continues whatever surface they lie on. Each predictor is trusted by how well it did on the
returns to the left and above.

The functions here see returns in coding order (ring by ring, by tick) and use only what precedes a
return, so the decoder repeats them: float64 with + - * / in a fixed order.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.ingest.sensor_model import SensorModel
from salpcc.stages.ingest.trig import TWO_PI

N_PREDICTORS = 6
N_SPREADS = 40
_FIRST_SPREAD = (1023 - 2) << 2  # of 0.25
_FAR_GAP = 12.0  # ticks; returns further apart are not neighbours
PRIOR_ERROR = 12.0  # counts, for a predictor that has not been tried yet


def ring_starts(laser: NDArray[np.uint8], lasers: int) -> NDArray[np.int64]:
    """Return where each ring starts among returns in firing order, ``(L + 1,)`` int64."""
    return np.searchsorted(laser, np.arange(lasers + 1)).astype(np.int64)


def laser_table(sensor: SensorModel) -> NDArray[np.float64]:
    """Return per laser ``(L, 3)``: range offset in counts, azimuth offset in ticks, lever arm in tick-counts.

    A return at count c is seen at azimuth ``tick + offset + lever / c`` ticks.
    """
    per_radian = sensor.ticks_per_turn / TWO_PI
    return np.stack(
        [sensor.d0 / sensor.count, sensor.phi0 * per_radian, sensor.h / sensor.count * per_radian], axis=1
    )


@njit(cache=True, error_model="numpy")
def new_state(n: int) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float32]]:
    """Return per return: 1/r, azimuth in ticks, and the errors ``(n, N_PREDICTORS)`` of the predictors."""
    return np.zeros(n), np.zeros(n), np.zeros((n, N_PREDICTORS), np.float32)


@njit(cache=True, error_model="numpy", inline="always")
def _upper_at(
    azimuth: float, j: int, begin: int, end: int, inverse: NDArray[np.float64], azimuths: NDArray[np.float64]
) -> float:
    """1/r of the ring above at an azimuth between its returns j and j + 1; 0 where it has none."""
    left = j >= begin and azimuth - azimuths[j] < _FAR_GAP
    right = j + 1 < end and azimuths[j + 1] - azimuth < _FAR_GAP
    if left and right:
        a = inverse[j]
        b = inverse[j + 1]
        t = (azimuth - azimuths[j]) / max(azimuths[j + 1] - azimuths[j], 1e-9)
        if abs(a - b) * 16.0 < a + b:
            return a + t * (b - a)
        return a if t < 0.5 else b
    if left:
        return inverse[j]
    if right:
        return inverse[j + 1]
    return 0.0


@njit(cache=True, error_model="numpy", inline="always")
def predict_return(
    i: int,
    begin: int,
    above: int,
    cursor: int,
    tick: int,
    lever: float,
    offset: float,
    inverse: NDArray[np.float64],
    azimuths: NDArray[np.float64],
    errors: NDArray[np.float32],
    running: NDArray[np.float64],
    guesses: NDArray[np.float64],
) -> tuple[float, float, int]:
    """Predict the range of return ``i``.

    Args:
        begin, above: first return of its ring and of the ring above (``above == begin``: none).
        cursor: where the ring above was left off.
        running: decayed errors of the predictors along this ring, ``(N_PREDICTORS,)``.
        guesses: receives what each predictor says of 1/r, ``(N_PREDICTORS,)``.

    Returns:
        predicted range and expected error, both in counts, and the new cursor.
    """
    has_left = i > begin
    w1 = inverse[i - 1] if has_left else 0.0
    azimuth = tick + offset + lever * w1
    j = cursor
    while j + 1 < begin and azimuths[j + 1] <= azimuth:
        j += 1
    while j >= above and azimuths[j] > azimuth:
        j -= 1
    up = _upper_at(azimuth, j, above, begin, inverse, azimuths)

    last = w1
    linear = w1
    gradient = w1
    if not has_left:
        last = up if up > 0.0 else 1e-3
        linear = last
        gradient = last
    else:
        if i - 2 >= begin:
            gap1 = azimuth - azimuths[i - 1]
            gap2 = azimuths[i - 1] - azimuths[i - 2]
            if gap2 > 0.0 and gap1 < 3.0 * gap2:
                linear = w1 + (w1 - inverse[i - 2]) * (gap1 / gap2)
        if up > 0.0:
            k = j
            before = azimuths[i - 1]
            while k >= above and azimuths[k] > before:
                k -= 1
            up_left = _upper_at(before, k, above, begin, inverse, azimuths)
            if up_left > 0.0:
                gradient = w1 + up - up_left
    low = 0.6 * last
    high = 1.7 * last
    linear = min(max(linear, low), high)
    gradient = min(max(gradient, low), high)
    guesses[0] = last
    guesses[1] = linear
    guesses[2] = gradient
    guesses[3] = up if up > 0.0 else last
    guesses[4] = 0.5 * (linear + gradient)
    guesses[5] = 0.5 * (last + gradient)

    total = 0.0
    mean = 0.0
    spread = 0.0
    left_above = j >= above
    right_above = j + 1 < begin
    for p in range(N_PREDICTORS):
        e = running[p] + 0.5
        if left_above:
            e += 0.5 * errors[j, p]
        if right_above:
            e += 0.5 * errors[j + 1, p]
        trust = 1.0 / (e * e * e)
        total += trust
        mean += trust * guesses[p]
        spread += trust * e
    spread /= total
    # Where the trusted ones disagree, the surface breaks.
    ranged = total / mean
    apart = abs(gradient - last) * ranged * ranged
    return ranged, spread + 0.25 * min(apart, 4.0 * spread), j


@njit(cache=True, error_model="numpy", inline="always")
def learn_return(
    i: int,
    range_counts: float,
    tick: int,
    lever: float,
    offset: float,
    inverse: NDArray[np.float64],
    azimuths: NDArray[np.float64],
    errors: NDArray[np.float32],
    running: NDArray[np.float64],
    guesses: NDArray[np.float64],
) -> None:
    """Take in the true range of return ``i``, in counts."""
    inverse[i] = 1.0 / max(range_counts, 1.0)
    azimuths[i] = tick + offset + lever * inverse[i]
    for p in range(N_PREDICTORS):
        # |r - 1/w| to first order, without the division
        e = min(abs(range_counts * guesses[p] - 1.0) * range_counts, 4000.0)
        errors[i, p] = e
        running[p] += 0.3 * (min(e, 200.0) - running[p])


@njit(cache=True, error_model="numpy")
def spread_bucket(spread: float) -> int:
    """Bucket of an expected error in levels, four to the octave from 1/4 up, 0 to N_SPREADS - 1.

    Exponent and two leading bits of the mantissa, read off the float64 itself.
    """
    bits = np.float64(min(max(spread, 0.25), 1e6)).view(np.int64)
    return min((bits >> 50) - _FIRST_SPREAD, N_SPREADS - 1)


@njit(cache=True, error_model="numpy")
def predict_levels(
    starts: NDArray[np.int64],
    tick: NDArray[np.int32],
    level: NDArray[np.int32],
    step: int,
    table: NDArray[np.float64],
) -> tuple[NDArray[np.int32], NDArray[np.uint8]]:
    """Predict every return of a sweep from the returns before it.

    Args:
        starts: see :func:`ring_starts`.  tick, level: ``(M,)``.  table: see :func:`laser_table`.

    Returns:
        predicted level int32 ``(M,)`` and spread bucket uint8 ``(M,)``.
    """
    n = len(tick)
    prediction = np.empty(n, np.int32)
    buckets = np.empty(n, np.uint8)
    inverse, azimuths, errors = new_state(n)
    guesses = np.zeros(N_PREDICTORS)
    above = 0
    middle = (step - 1) / 2.0
    for k in range(len(starts) - 1):
        begin = starts[k]
        running = np.full(N_PREDICTORS, PRIOR_ERROR)
        cursor = above - 1
        for i in range(begin, starts[k + 1]):
            mean, spread, cursor = predict_return(
                i, begin, above, cursor, tick[i], table[k, 2], table[k, 1],
                inverse, azimuths, errors, running, guesses,
            )  # fmt: skip
            prediction[i] = np.int32(np.floor((mean - table[k, 0] - middle) / step + 0.5))
            buckets[i] = spread_bucket(spread / step)
            learn_return(
                i, level[i] * step + middle + table[k, 0], tick[i], table[k, 2], table[k, 1],
                inverse, azimuths, errors, running, guesses,
            )  # fmt: skip
        if starts[k + 1] > begin:
            above = begin
    return prediction, buckets
