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

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.lattice.sensor_model import SensorModel
from salpcc.stages.lattice.trig import TWO_PI, sin_cos
from salpcc.stages.predict.vectors import (
    Lanes,
    count,
    inline,
    kernel,
    lane,
    larger,
    load,
    of,
    pick,
    size,
    smaller,
    splice,
    spread,
    store,
)

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
# Columns of a ring's memory: 1/rho, azimuth, denoised 1/rho; four together: errors of the predictors, residual.
_INVERSE, _AZIMUTH, _CLEAN, _ERRORS = 0, 1, 2, 4
COLUMNS = 8


@njit(cache=True)
def _cosines(theta: F64) -> F64:
    return np.array([max(sin_cos(angle)[1], 0.01) for angle in theta])


def laser_table(sensor: SensorModel) -> F64:
    """Return per laser ``(L, 4)``: range offset in counts, azimuth offset in ticks, lever arm in tick-counts, cos theta."""
    per_radian = sensor.ticks_per_turn / TWO_PI
    columns = sensor.d0 / sensor.count, sensor.phi0 * per_radian, sensor.h / sensor.count * per_radian
    return np.stack([*columns, _cosines(sensor.theta)], axis=1)


class Ring(NamedTuple):
    """Numbers of one ring, of its laser and of the step of levels."""

    base: float  # counts of the middle of level 0
    offset: float  # azimuth, ticks
    lever: float  # arm, tick-counts
    cosine: float
    per_cosine: float
    step: int
    per_step: float


@inline
def ring_of(table: F64, laser: int, step: int) -> Ring:
    """Return the numbers of a laser's ring; table from :func:`laser_table`."""
    base = table[laser, 0] + (step - 1) / 2.0
    cosine = table[laser, 3]
    return Ring(base, table[laser, 1], table[laser, 2], cosine, 1.0 / cosine, step, 1.0 / step)


@kernel
def align(tick, first, n, ring, above, n_above, clean, errors):  # type: ignore[no-untyped-def]
    """See the ring above from a ring: its denoised 1/rho at each azimuth (0: none), and how well it was predicted.

    Args:
        first, n: the ring's returns.  above: the memory of the ring above.
        clean: receives 1/rho, ``(n,)``.  errors: receives ``(n, 4)``: 0.5 + means of the predictors', sum of residuals.
    """
    base, part = of(0.5, 0.5, 0.5, 0.0), of(0.5, 0.5, 0.5, 1.0)
    j = -1
    last = n_above - 1
    for i in range(n):
        azimuth = (
            tick[np.uint64(first + i)] + ring.offset + ring.lever * above[np.uint64(max(j, 0)), _INVERSE]
        )
        while j < last and above[np.uint64(j + 1), _AZIMUTH] <= azimuth:
            j += 1
        while j >= 0 and above[np.uint64(j), _AZIMUTH] > azimuth:
            j -= 1
        a = np.uint64(max(j, 0))
        b = np.uint64(min(j + 1, last))
        after = azimuth - above[a, _AZIMUTH]
        before = above[b, _AZIMUTH] - azimuth
        left = j >= 0 and after < _FAR_GAP
        right = j < last and before < _FAR_GAP
        p = above[a if left else b, _CLEAN]
        q = above[b if right else a, _CLEAN]
        t = after / max(after + before, 1e-9) if left and right else 0.0
        between = p + t * (q - p)
        nearest = p if t < 0.5 else q
        seen = between if abs(p - q) * 16.0 < p + q else nearest
        at = np.uint64(i)
        clean[at] = seen if left or right else 0.0
        both = load(above, int(a) * COLUMNS + _ERRORS, 4) + load(above, int(b) * COLUMNS + _ERRORS, 4)
        store(errors, i * 4, base + part * both)


@njit(cache=True)
def errors_without(size: int) -> F64:
    """Return what :func:`align` finds of errors where there is no ring above, ``(size, 4)``."""
    errors = np.full((size, 4), 0.5)
    errors[:, 3] = 2.0 * _PRIOR_ERROR
    return errors


class Running(NamedTuple):
    """What has been learned along a ring; distances as 1/rho.

    Attributes:
        errors: of the three predictors in counts, running; a fourth lane is nobody's.
        miss: of the prediction before, counts.  activity: its running size.
        difference: running, to the ring above.  followed: whether there is one.
        level, slope: running.  last: of the return before.
    """

    errors: Lanes
    miss: float
    activity: float
    difference: float
    followed: bool
    level: float
    slope: float
    last: float


class Guess(NamedTuple):
    """A prediction: its context, the level, 1/rho by the three predictors, and by all."""

    context: int
    level: int
    of_each: Lanes
    inverse: float


@inline
def begin_ring(clean: float) -> Running:
    """Return what is known before the first return of a ring, where the ring above says 1/rho ``clean`` (0: nothing)."""
    last = clean if clean > 0.0 else 1e-3
    return Running(spread(_PRIOR_ERROR, 4), 0.0, 10.0, 0.0, False, last, 0.0, last)


@inline
def guess(known: Running, gap: float, clean: float, errors: Lanes, ring: Ring) -> Guess:
    """Predict a return ``gap`` ticks behind the one before, by what :func:`align` found at it."""
    last = known.last
    smooth = clean + known.difference if clean > 0.0 and known.followed else last
    trend = known.level + known.slope * gap
    of_each = smaller(1.7 * last, larger(0.6 * last, of(last, smooth, trend, last)))
    smooth, trend = lane(of_each, 1), lane(of_each, 2)
    # Weights 1 / error^3, times all three errors, so that one division does.
    x = known.errors + errors
    w = pick(x, 1, 0, 0, 3) * pick(x, 2, 2, 1, 3)
    w = w * w * w
    wp, wx = w * of_each, w * x
    total = lane(w, 0) + lane(w, 1) + lane(w, 2)
    mean = lane(wp, 0) + lane(wp, 1) + lane(wp, 2)
    rho = total / mean
    r = rho * ring.per_cosine
    counts = r * rho  # of a unit of 1/rho, here
    before = (0.26 + 0.031 * gap + 0.0016 * lane(errors, 3)) + (
        0.069 * abs(known.miss) + 0.070 * known.activity
    )
    expected = (before + 0.064 * ((lane(wx, 0) + lane(wx, 1) + lane(wx, 2)) / total)) + (
        4.9e-6 * r
        + (
            0.081 * min(abs(smooth - trend) * counts, 500.0)
            + 0.0155 * min(abs(smooth - last) * counts, 500.0)
        )
    )
    aside = (1.0 - last * rho) * r
    side = count(aside >= of(-1.5, -0.4, 0.4, 1.5) * expected)
    fine = np.float64(min(max(expected * ring.per_step, 0.125), 255.0)).view(np.int64) >> 50
    # A sensor with odd numbers may make NaN of it, which must not lead out of the tables.
    context = min(max(int(fine) - _FINEST, 0), CONTEXTS // _SIDES - 1) * _SIDES + side
    level = int(min(max((r - ring.base) * ring.per_step + 0.5, 0.0), MAX_LEVEL + 0.0))
    return Guess(context, level, of_each, mean / total)


@inline
def learn(
    known: Running,
    guessed: Guess,
    found: int,
    gap: float,
    clean: float,
    at: int,
    tick: int,
    ring: Ring,
    here: F64,
) -> Running:
    """Return what is known after a return of level ``found``; its row of the ring's memory ``here`` is filled."""
    inverse = guessed.inverse
    miss = min(max(np.float64((found - guessed.level) * ring.step), -500.0), 500.0)
    activity = known.activity + 0.2 * (min(abs(miss), 200.0) - known.activity)
    r = max(found * ring.step + ring.base, 1.0)
    rho = max(r * ring.cosine, 1.0)
    w = 1.0 / rho
    off_each = smaller(4000.0, size(guessed.of_each * rho - 1.0) * r)
    errors = known.errors + (smaller(200.0, off_each) - known.errors) * _ERROR_RATE
    per_surface = rho * r * (1.0 / _SURFACE)
    off = (w - inverse) * per_surface
    row = np.uint64(at)
    here[row, _INVERSE] = w
    here[row, _AZIMUTH] = tick + ring.offset + ring.lever * w
    here[row, _CLEAN] = w + _DENOISE * max(1.0 - off * off, 0.0) * (inverse - w)
    store(here, at * COLUMNS + _ERRORS, splice(off_each, spread(abs(miss), 4), 3))
    # Without branches: where surfaces end, nobody foresees.
    drift = w - clean - known.difference
    off = drift * per_surface
    rate = min(_OFFSET_RATE + off * off, 1.0)
    nearer = known.difference + (rate if known.followed else 1.0) * drift
    difference = nearer if clean > 0.0 else known.difference
    ahead = known.level + known.slope * gap
    drift = w - ahead
    off = drift * per_surface
    off *= off
    level = ahead + min(_LEVEL_RATE + off, 1.0) * drift
    slope = known.slope + _SLOPE_RATE * drift / gap
    slope = slope if off < 9.0 else 0.0
    if at == 0:
        level, slope = w, 0.0
    return Running(errors, miss, activity, difference, known.followed or clean > 0.0, level, slope, w)
