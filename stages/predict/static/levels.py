"""Range levels of effort ``fast``: three predictors in 1/rho, weighed by how well they did, and a context.

``1 / rho`` (rho: horizontal distance) is linear over a plane in azimuth and in the tangent of the elevation, so the
difference between two rings is constant along a plane. The predictors are the return before; the ring above at
the same azimuth plus a running mean of that difference; and the line that a running level and slope continue.
Means over many returns carry little of their noise, which is what most bits are spent on. A running mean that is
far off starts anew: a surface ended there.

Encoder and decoder are one walk (:mod:`.walk`). What is known of the rings stands in columns (:mod:`.columns`), so that the next
returns of eight rings are guessed, and learned from, in one go.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.lattice.sensor_model import SensorModel
from salpcc.stages.lattice.trig import TWO_PI, sin_cos
from salpcc.stages.predict.static.columns import LANES, WIDTH, Columns, F, cell, put, renew, take
from salpcc.stages.vectors import (
    bits,
    cast,
    choose,
    inline,
    kernel,
    lane,
    larger,
    load,
    of,
    size,
    smaller,
    spread,
    store,
    whole,
)

F64 = NDArray[np.float64]
F32 = NDArray[np.float32]

MAX_LEVEL = (1 << 20) - 1
CONTEXTS = 220
_QUARTERS, _FINEST = np.int32(21), F((127 - 3) << 2)  # bits below quarter octaves; that of 1/8 of a level
_SIDES = F(5.0)
_ZERO, _HALF, _ONE, _TWO, _SIXTEEN = F(0.0), F(0.5), F(1.0), F(2.0), F(16.0)
_FAR_GAP = F(12.0)  # ticks; returns further apart are not neighbours
_PER_SURFACE = F(1.0 / 45.0)  # counts; a return so far off does not belong to the running means
_OFFSET_RATE, _LEVEL_RATE, _SLOPE_RATE, _ERROR_RATE, _ACTIVITY_RATE = F(0.12), F(0.4), F(0.2), F(0.25), F(0.2)
_DENOISE = F(0.55)
_PRIOR_ERROR, _PRIOR_ACTIVITY = F(12.0), F(10.0)  # counts
_PRIOR = F(1e-3)  # 1/rho
_LOWEST, _HIGHEST = F(0.6), F(1.7)  # of 1/rho of the return before
_EXPECTED, _OF_GAP, _OF_MISSES = F(0.26), F(0.031), F(0.0016)
_OF_MISS, _OF_ACTIVITY, _OF_ERRORS, _OF_RANGE = F(0.069), F(0.070), F(0.064), F(4.9e-6)
_OF_TREND, _OF_STEP = F(0.081), F(0.0155)
_NEAR_SIDE, _FAR_SIDE = F(0.4), F(1.5)  # of what is expected
_LEAST, _MOST, _TOP = F(0.125), F(255.0), F(MAX_LEVEL)
_LIMIT, _FAR, _FARTHEST = F(200.0), F(500.0), F(4000.0)  # counts
_STEEP = F(9.0)
_NOTHING, _NONE = F(1e-9), F(np.inf)  # ticks

# The row of a return that the ring below may see: 1/rho, azimuth, denoised 1/rho, nothing; errors of the predictors, residual.
DEPTH, _ROW = 64, 8
_INVERSE, _AZIMUTH, _CLEAN, _ERRORS = np.uint64(0), np.uint64(1), np.uint64(2), np.uint64(4)
# Columns: numbers of the ring;
BASE, OFFSET, LEVER, COSINE, PER_COSINE = range(5)
# what has been learned along it, distances as 1/rho: errors of the predictors in counts, running; the prediction before's miss in counts,
# and its running size; difference to the ring above, running, and whether there is one; running level and slope; of the return before;
E0, E1, E2, MISS, ACTIVITY, DIFFERENCE, FOLLOWED, RUNNING, SLOPE, LAST = range(5, 15)
# what its next return sees: whether there is one in this wave, its tick; ticks to its neighbours above and their 1/rho; their errors, their misses;
ACTIVE, TICK, AFTER, BEFORE, LEFT, RIGHT, U0, U1, U2, UM = range(15, 25)
# what is guessed: 1/rho by each predictor, of the ring above, of the line, by all; the context; the level, and the one that was found.
P0, P1, P2, SEEN, AHEAD, GUESSED, CONTEXT, LEVEL, FOUND, DENOISED = range(25, 35)
# Tick and azimuth of the return before, and how many ticks before.
WAS, AZIMUTH, GAP = range(35, 38)
COLUMNS = 38


@njit(cache=True)
def _cosines(theta: F64) -> F64:
    return np.array([max(sin_cos(angle)[1], 0.01) for angle in theta])


def laser_table(sensor: SensorModel) -> F64:
    """Return per laser ``(L, 4)``: range offset in counts, azimuth offset in ticks, lever arm in tick-counts, cos theta."""
    per_radian = sensor.ticks_per_turn / TWO_PI
    columns = sensor.d0 / sensor.count, sensor.phi0 * per_radian, sensor.h / sensor.count * per_radian
    return np.stack([*columns, _cosines(sensor.theta)], axis=1)


@njit(cache=True)
def begin(table: F64, rings: NDArray[np.int64], step: int) -> Columns:
    """Return the columns of ``rings`` before their first returns; table from :func:`laser_table`."""
    columns = np.zeros((COLUMNS, WIDTH), np.float32)
    columns[COSINE] = columns[PER_COSINE] = columns[GAP] = _ONE
    columns[E0] = columns[E1] = columns[E2] = _PRIOR_ERROR
    columns[ACTIVITY] = _PRIOR_ACTIVITY
    for r in range(len(rings)):
        offset, azimuth, lever, cosine = table[rings[r]]
        columns[BASE, r] = offset + (step - 1) / 2.0  # counts of the middle of level 0
        columns[OFFSET, r], columns[LEVER, r] = azimuth, lever
        columns[COSINE, r], columns[PER_COSINE, r] = cosine, 1.0 / cosine
    return columns.reshape(-1)


@njit(cache=True)
def no_rows(rings: int) -> F32:
    """Return room for the rows of the last DEPTH returns of each ring; rings stand a row further apart than that, for the sake of caches."""
    return np.zeros(rings * (DEPTH + 1) * _ROW, np.float32)


@inline
def _row(r: int, i: int) -> np.uint64:
    """Return where the row of return ``i`` of ring ``r`` begins."""
    return np.uint64((r * (DEPTH + 1) + (i & (DEPTH - 1))) * _ROW)


@inline
def row_above(r: int, i: int) -> np.uint64:
    """Return where the row of return ``i`` of the ring above ring ``r`` begins; some row, if there is no ring above."""
    return _row(max(r - 1, 0), i)


@inline
def see(r: int, tick: np.float32, known: int, j: int, columns: Columns, rows: F32) -> int:
    """Fill the columns of what the next return of ring ``r`` sees of the ring above.

    Args:
        known: returns of the ring above that are known.
        j: what the return before gave, -1 at first.

    Returns:
        the last return of the ring above that is not behind this one, -1 for none.
    """
    if known == 0:
        columns[cell(AFTER, r)] = columns[cell(BEFORE, r)] = _NONE
        columns[cell(U0, r)] = columns[cell(U1, r)] = columns[cell(U2, r)] = _ZERO
        columns[cell(UM, r)] = _PRIOR_ERROR + _PRIOR_ERROR
        return j
    above, last, oldest = r - 1, known - 1, max(known - DEPTH, 0)
    j = max(j, oldest - 1)
    azimuth = (tick + columns[cell(OFFSET, r)]) + columns[cell(LEVER, r)] * rows[
        _row(above, max(j, oldest)) + _INVERSE
    ]
    while j < last and rows[_row(above, j + 1) + _AZIMUTH] <= azimuth:
        j += 1
    while j >= oldest and rows[_row(above, j) + _AZIMUTH] > azimuth:
        j -= 1
    a, b = _row(above, max(j, oldest)), _row(above, min(j + 1, last))
    columns[cell(AFTER, r)] = azimuth - rows[a + _AZIMUTH] if j >= oldest else _NONE
    columns[cell(BEFORE, r)] = rows[b + _AZIMUTH] - azimuth if j < last else _NONE
    columns[cell(LEFT, r)], columns[cell(RIGHT, r)] = rows[a + _CLEAN], rows[b + _CLEAN]
    both = load(rows, a + _ERRORS, 4) + load(rows, b + _ERRORS, 4)
    columns[cell(U0, r)], columns[cell(U1, r)] = lane(both, 0), lane(both, 1)
    columns[cell(U2, r)], columns[cell(UM, r)] = lane(both, 2), lane(both, 3)
    return j


@kernel
def guess(columns: Columns, first: int, end: int, per_step: float) -> None:
    """Guess the next levels of rings ``first`` to before ``end``, by what :func:`see` found."""
    one, zero = spread(_ONE, LANES), spread(_ZERO, LANES)
    two, prior = spread(_TWO, LANES), spread(_PRIOR, LANES)
    for at in range(first, end, LANES):
        after, before = take(columns, AFTER, at), take(columns, BEFORE, at)
        left, right = after < _FAR_GAP, before < _FAR_GAP
        pa, pb = take(columns, LEFT, at), take(columns, RIGHT, at)
        p, q = choose(left, pa, pb), choose(right, pb, pa)
        t = choose(left, choose(right, after / larger(after + before, _NOTHING), zero), zero)
        nearest = choose(t < _HALF, p, q)
        seen = choose(size(p - q) * _SIXTEEN < p + q, p + t * (q - p), nearest)
        clean = choose(left, seen, choose(right, seen, zero))
        put(columns, SEEN, at, clean)
        last = take(columns, LAST, at)
        begun = last > _ZERO
        gap = choose(begun, take(columns, TICK, at) - take(columns, WAS, at), two)
        put(columns, GAP, at, gap)
        last = choose(begun, last, choose(clean > _ZERO, clean, prior))
        known = choose(take(columns, FOLLOWED, at) > _ZERO, clean + take(columns, DIFFERENCE, at), last)
        smooth = choose(clean > _ZERO, known, last)
        trend = choose(begun, take(columns, RUNNING, at), last) + take(columns, SLOPE, at) * gap
        put(columns, AHEAD, at, trend)
        low, high = last * _LOWEST, last * _HIGHEST
        smooth, trend = smaller(high, larger(low, smooth)), smaller(high, larger(low, trend))
        put(columns, P0, at, last)
        put(columns, P1, at, smooth)
        put(columns, P2, at, trend)
        # Weights 1 / error^3, times all three errors, so that one division does.
        x0 = take(columns, E0, at) + (take(columns, U0, at) * _HALF + _HALF)
        x1 = take(columns, E1, at) + (take(columns, U1, at) * _HALF + _HALF)
        x2 = take(columns, E2, at) + (take(columns, U2, at) * _HALF + _HALF)
        w0, w1, w2 = x1 * x2, x0 * x2, x0 * x1
        w0, w1, w2 = w0 * w0 * w0, w1 * w1 * w1, w2 * w2 * w2
        total = w0 + w1 + w2
        mean = w0 * last + w1 * smooth + w2 * trend
        part = _ONE / total
        rho = total / mean
        put(columns, GUESSED, at, mean * part)
        r = rho * take(columns, PER_COSINE, at)
        counts = r * rho  # of a unit of 1/rho, here
        expected = (gap * _OF_GAP + _EXPECTED + take(columns, UM, at) * _OF_MISSES) + (
            size(take(columns, MISS, at)) * _OF_MISS + take(columns, ACTIVITY, at) * _OF_ACTIVITY
        )
        expected = (expected + (w0 * x0 + w1 * x1 + w2 * x2) * part * _OF_ERRORS) + (
            r * _OF_RANGE
            + (
                smaller(size(smooth - trend) * counts, _FAR) * _OF_TREND
                + smaller(size(smooth - last) * counts, _FAR) * _OF_STEP
            )
        )
        aside = (_ONE - last * rho) * r
        near, wide = expected * _NEAR_SIDE, expected * _FAR_SIDE
        side = (
            choose(aside + wide >= _ZERO, one, zero)
            + choose(aside + near >= _ZERO, one, zero)
            + choose(aside >= near, one, zero)
            + choose(aside >= wide, one, zero)
        )
        octave = cast(bits(smaller(larger(expected * per_step, _LEAST), _MOST)) >> _QUARTERS, F) - _FINEST
        put(columns, CONTEXT, at, octave * _SIDES + side)
        level = smaller(larger((r - take(columns, BASE, at)) * per_step + _HALF, _ZERO), _TOP)
        put(columns, LEVEL, at, whole(level))


@inline
def context_of(columns: Columns, r: int) -> int:
    """Return the context of the level that is guessed of ring ``r``."""
    return int(columns[cell(CONTEXT, r)])


@kernel
def learn(columns: Columns, first: int, end: int, step: float) -> None:
    """Learn from the levels that were found of the active rings among them."""
    one, zero = spread(_ONE, LANES), spread(_ZERO, LANES)
    for at in range(first, end, LANES):
        active = take(columns, ACTIVE, at) > _ZERO
        found = take(columns, FOUND, at)
        miss = (found - take(columns, LEVEL, at)) * step
        miss = smaller(larger(miss, -_FAR), _FAR)
        renew(columns, MISS, at, active, miss)
        activity = take(columns, ACTIVITY, at)
        renew(
            columns,
            ACTIVITY,
            at,
            active,
            activity + (smaller(size(miss), _LIMIT) - activity) * _ACTIVITY_RATE,
        )
        r = larger(found * step + take(columns, BASE, at), _ONE)
        rho = larger(r * take(columns, COSINE, at), _ONE)
        w = _ONE / rho
        tick = take(columns, TICK, at)
        put(columns, WAS, at, tick)
        put(columns, AZIMUTH, at, (tick + take(columns, OFFSET, at)) + take(columns, LEVER, at) * w)
        for k in range(3):
            off = smaller(size(take(columns, P0 + k, at) * rho - _ONE) * r, _FARTHEST)
            put(columns, U0 + k, at, off)
            error = take(columns, E0 + k, at)
            renew(columns, E0 + k, at, active, error + (smaller(off, _LIMIT) - error) * _ERROR_RATE)
        per_surface = rho * r * _PER_SURFACE
        inverse = take(columns, GUESSED, at)
        off = (w - inverse) * per_surface
        put(columns, DENOISED, at, w + larger(_ONE - off * off, _ZERO) * _DENOISE * (inverse - w))
        begun = take(columns, LAST, at) > _ZERO
        renew(columns, LAST, at, active, w)
        seen, followed = take(columns, SEEN, at), take(columns, FOLLOWED, at)
        difference = take(columns, DIFFERENCE, at)
        drift = w - seen - difference
        off = drift * per_surface
        rate = choose(followed > _ZERO, smaller(off * off + _OFFSET_RATE, _ONE), one)
        renew(columns, DIFFERENCE, at, active, choose(seen > _ZERO, difference + rate * drift, difference))
        renew(columns, FOLLOWED, at, active, choose(seen > _ZERO, one, followed))
        ahead = take(columns, AHEAD, at)
        drift = w - ahead
        off = drift * per_surface
        off = off * off
        running = ahead + smaller(off + _LEVEL_RATE, _ONE) * drift
        renew(columns, RUNNING, at, active, choose(begun, running, w))
        slope = take(columns, SLOPE, at) + drift * _SLOPE_RATE / take(columns, GAP, at)
        renew(columns, SLOPE, at, active, choose(begun, choose(off < _STEEP, slope, zero), zero))


@inline
def leave(r: int, i: int, columns: Columns, rows: F32) -> None:
    """Leave behind what the ring below may see of return ``i`` of ring ``r``."""
    row = _row(r, i)
    rows[row + _INVERSE] = columns[cell(LAST, r)]
    rows[row + _AZIMUTH] = columns[cell(AZIMUTH, r)]
    rows[row + _CLEAN] = columns[cell(DENOISED, r)]
    missed = abs(columns[cell(MISS, r)])
    errors = of(columns[cell(U0, r)], columns[cell(U1, r)], columns[cell(U2, r)], missed)
    store(rows, row + _ERRORS, errors)
