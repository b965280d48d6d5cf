"""Range levels of effort ``fast``: three predictors in 1/rho, weighed by how well they did, and a context.

``1 / rho`` (rho: horizontal distance) is linear over a plane in azimuth and in the tangent of the elevation, so the
difference between two rings is constant along a plane. The predictors are the return before; the ring above at
the same azimuth plus a running mean of that difference; and the line that a running level and slope continue.
Means over many returns carry little of their noise, which is what most bits are spent on. A running mean that is
far off starts anew: a surface ended there.

Encoder and decoder are one walk. Rings are walked in turn; what depends on the ring above alone is worked
out for the whole ring before.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.entropy.rans import begin, ended
from salpcc.stages.lattice.sensor_model import SensorModel
from salpcc.stages.lattice.trig import TWO_PI, sin_cos
from salpcc.stages.predict.static.tokens import get
from salpcc.stages.predict.sweep_walk import longest_ring

F64 = NDArray[np.float64]

MAX_LEVEL = (1 << 20) - 1
CONTEXTS = 220
_FINEST = (1023 - 3) << 2  # of 1/8 of a level, quarter octaves
_SIDES = 5
_FAR_GAP = 12.0  # ticks; returns further apart are not neighbours
_SURFACE = 45.0  # counts; a return so far off does not belong to the running means
_OFFSET_RATE = 0.12
_LEVEL_RATE = 0.4
_SLOPE_RATE = 0.2
_DENOISE = 0.55
_ERROR_RATE = 0.25
_PRIOR_ERROR = 12.0  # counts
# Rows of a ring's memory: 1/rho, azimuth, denoised 1/rho, errors of the predictors, residual.
_INVERSE, _AZIMUTH, _CLEAN, _ERROR0, _ERROR1, _ERROR2, _MISS = range(7)


@njit(cache=True)
def _cosines(theta: F64) -> F64:
    return np.array([max(sin_cos(angle)[1], 0.01) for angle in theta])


def laser_table(sensor: SensorModel) -> F64:
    """Return per laser ``(L, 4)``: range offset in counts, azimuth offset in ticks, lever arm in tick-counts, cos theta."""
    per_radian = sensor.ticks_per_turn / TWO_PI
    columns = sensor.d0 / sensor.count, sensor.phi0 * per_radian, sensor.h / sensor.count * per_radian
    return np.stack([*columns, _cosines(sensor.theta)], axis=1)


@njit(cache=True, error_model="numpy")
def _align(ticks, offset, lever, above, n_above, clean, errors):  # type: ignore[no-untyped-def]
    """See the ring above from a ring: its denoised 1/rho at each azimuth (0: none), and how well it was predicted.

    Args:
        ticks: ``(n,)`` of the ring.  above: the memory of the ring above.
        clean: receives 1/rho, ``(n,)``.  errors: receives ``(4, n)``.
    """
    j = -1
    for i in range(len(ticks)):
        azimuth = ticks[i] + offset + lever * above[_INVERSE, max(j, 0)]
        while j + 1 < n_above and above[_AZIMUTH, j + 1] <= azimuth:
            j += 1
        while j >= 0 and above[_AZIMUTH, j] > azimuth:
            j -= 1
        a = np.uint64(max(j, 0))
        b = np.uint64(min(j + 1, n_above - 1))
        after = azimuth - above[_AZIMUTH, a]
        before = above[_AZIMUTH, b] - azimuth
        left = j >= 0 and after < _FAR_GAP
        right = j + 1 < n_above and before < _FAR_GAP
        p = above[_CLEAN, a if left else b]
        q = above[_CLEAN, b if right else a]
        t = after / max(after + before, 1e-9) if left and right else 0.0
        between = p + t * (q - p)
        nearest = p if t < 0.5 else q
        seen = between if abs(p - q) * 16.0 < p + q else nearest
        clean[i] = seen if left or right else 0.0
        errors[0, i] = 0.5 + 0.5 * (above[_ERROR0, a] + above[_ERROR0, b])
        errors[1, i] = 0.5 + 0.5 * (above[_ERROR1, a] + above[_ERROR1, b])
        errors[2, i] = 0.5 + 0.5 * (above[_ERROR2, a] + above[_ERROR2, b])
        errors[3, i] = above[_MISS, a] + above[_MISS, b]


@njit(cache=True, error_model="numpy", nogil=True)
def walk_levels(  # type: ignore[no-untyped-def]
    decoding, starts, tick, level, step, table, context, residual, start, guide, words
):
    """Predict the levels of a sweep, and decode them on the way if asked to.

    Args:
        starts: first return of each ring, ``(L + 1,)``.  tick: ``(M,)``.  table: see :func:`laser_table`.
        level: int32 ``(M,)``, read, or filled when decoding.
        context, residual: uint8 and int32 ``(M,)``, filled unless decoding.
        start, guide, words: tables and words to decode from.

    Returns:
        whether the words were those of an encoder.
    """
    size = longest_ring(starts) + 1
    memory = np.zeros((2, 7, size))
    clean = np.zeros(size)
    errors = np.full((4, size), 0.5)
    errors[3, :] = 2.0 * _PRIOR_ERROR
    per_step = 1.0 / step
    middle = (step - 1) / 2.0
    x = 0
    position = 0
    if decoding:
        x, position = begin(words)
        if x == 0:
            return False
    now = 0
    n_above = 0
    for k in range(len(starts) - 1):
        first = starts[k]
        n = starts[k + 1] - first
        if n == 0:
            continue
        above = memory[1 - now]
        here = memory[now]
        base = table[k, 0] + middle
        offset = table[k, 1]
        lever = table[k, 2]
        cosine = table[k, 3]
        per_cosine = 1.0 / cosine
        ticks = tick[first : first + n]
        if n_above > 0:
            _align(ticks, offset, lever, above, n_above, clean, errors)
        e0 = e1 = e2 = _PRIOR_ERROR
        miss = 0.0
        activity = 10.0
        difference = 0.0
        followed = False
        running = 0.0
        slope = 0.0
        last = 0.0
        for i in range(n):
            m = clean[i]
            gap = 2.0
            if i == 0:
                last = m if m > 0.0 else 1e-3
                smooth = last
                trend = last
            else:
                gap = np.float64(ticks[i] - ticks[i - 1])
                smooth = m + difference if m > 0.0 and followed else last
                trend = running + slope * gap
                low = 0.6 * last
                high = 1.7 * last
                smooth = min(max(smooth, low), high)
                trend = min(max(trend, low), high)
            # Weights 1 / error^3, times all three errors, so that one division does.
            x0 = e0 + errors[0, i]
            x1 = e1 + errors[1, i]
            x2 = e2 + errors[2, i]
            w0 = x1 * x2
            w1 = x0 * x2
            w2 = x0 * x1
            w0 = w0 * w0 * w0
            w1 = w1 * w1 * w1
            w2 = w2 * w2 * w2
            total = w0 + w1 + w2
            mean = w0 * last + w1 * smooth + w2 * trend
            rho = total / mean
            inverse = mean / total
            r = rho * per_cosine
            counts = r * rho  # of a unit of 1/rho, here
            known = (0.26 + 0.031 * gap + 0.0016 * errors[3, i]) + (0.069 * abs(miss) + 0.070 * activity)
            expected = (known + 0.064 * ((w0 * x0 + w1 * x1 + w2 * x2) / total)) + (
                4.9e-6 * r
                + (
                    0.081 * min(abs(smooth - trend) * counts, 500.0)
                    + 0.0155 * min(abs(smooth - last) * counts, 500.0)
                )
            )
            aside = (1.0 - last * rho) * r
            side = (
                np.int64(aside >= -1.5 * expected)
                + np.int64(aside >= -0.4 * expected)
                + np.int64(aside >= 0.4 * expected)
                + np.int64(aside >= 1.5 * expected)
            )
            fine = np.float64(min(max(expected * per_step, 0.125), 255.0)).view(np.int64) >> 50
            # A sensor with odd numbers may make NaN of it, which must not lead out of the tables.
            c = min(max(int(fine) - _FINEST, 0), CONTEXTS // _SIDES - 1) * _SIDES + side
            predicted = np.int64(min(max((r - base) * per_step + 0.5, 0.0), MAX_LEVEL + 0.0))
            at = first + i
            if decoding:
                change, x, position = get(x, position, words, c, start, guide)
                found = min(max(predicted + change, 0), MAX_LEVEL)
                change = found - predicted
                level[at] = found
            else:
                found = np.int64(level[at])
                change = found - predicted
                context[at] = c
                residual[at] = change
            miss = min(max(np.float64(change * step), -500.0), 500.0)
            activity += 0.2 * (min(abs(miss), 200.0) - activity)
            r = max(found * step + base, 1.0)
            rho = max(r * cosine, 1.0)
            w = 1.0 / rho
            a0 = min(abs(rho * last - 1.0) * r, 4000.0)
            a1 = min(abs(rho * smooth - 1.0) * r, 4000.0)
            a2 = min(abs(rho * trend - 1.0) * r, 4000.0)
            e0 += _ERROR_RATE * (min(a0, 200.0) - e0)
            e1 += _ERROR_RATE * (min(a1, 200.0) - e1)
            e2 += _ERROR_RATE * (min(a2, 200.0) - e2)
            per_surface = rho * r * (1.0 / _SURFACE)
            off = (w - inverse) * per_surface
            here[_INVERSE, i] = w
            here[_AZIMUTH, i] = ticks[i] + offset + lever * w
            here[_CLEAN, i] = w + _DENOISE * max(1.0 - off * off, 0.0) * (inverse - w)
            here[_ERROR0, i] = a0
            here[_ERROR1, i] = a1
            here[_ERROR2, i] = a2
            here[_MISS, i] = abs(miss)
            if m > 0.0:
                drift = w - m - difference
                off = drift * per_surface
                difference += (min(_OFFSET_RATE + off * off, 1.0) if followed else 1.0) * drift
                followed = True
            if i == 0:
                running = w
            else:
                ahead = running + slope * gap
                drift = w - ahead
                off = drift * per_surface
                off *= off
                running = ahead + min(_LEVEL_RATE + off, 1.0) * drift
                slope = slope + _SLOPE_RATE * drift / gap if off < 9.0 else 0.0
            last = w
        now = 1 - now
        n_above = n
    return (not decoding) or ended(x, position, words)
