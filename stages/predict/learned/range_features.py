"""Predictors and features of one return's range, from the returns coded before it.

Everything lives in inverse horizontal range ``w = 1 / rho'``, where a plane is linear in azimuth and
in the tangent of the elevation (docs/sensor_lattice.md, section 3). Rings are coded top first, returns by
rising tick. The lever arm of docs/sensor_lattice.md, section 1, shifts what a laser sees at a given tick,
so the rings above are first moved into the tick frame of the current laser.

The decoder repeats all of this, hence only float64 and float32 with ``+ - * /`` and square roots, in
a fixed order: the same bits on every machine (docs/sensor_lattice.md, section 4).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from salpcc.stages.predict.learned.local_plane import LEFT, SECOND, UPPER, around, fit_plane, residuals, weigh
from salpcc.stages.predict.ring_rows import PAD
from salpcc.stages.predict.vectors import (
    Lanes,
    cast,
    choose,
    inline,
    join,
    lane,
    larger,
    load,
    of,
    root,
    size,
    smaller,
    splice,
    spread,
    store,
    whole,
)

PREDICTORS = 10
INPUTS = 72
SCALE_BITS = 7
SCALE = 128.0  # one unit of a feature, in steps of the integer network
LIMIT = 1023.0
GAPS = 8  # features that do not depend on the return before

# Where the features stand among the inputs of the network; gaps and residuals first.
_RESIDUALS, _OFFSETS, _GAPS, _ERRORS, _ERRORS_ABOVE, _REST, END = 0, 24, 38, 46, 56, 66, 76
# That place for each input of the network as trained.
INPUT_PLACES = (
    *range(_OFFSETS, _OFFSETS + 9),
    *range(_RESIDUALS, _RESIDUALS + 24),
    _OFFSETS + 9, _OFFSETS + 10, *range(_GAPS, _GAPS + 5), _OFFSETS + 11, _GAPS + 5, _OFFSETS + 12,
    *range(_ERRORS, _ERRORS + 10),
    *range(_ERRORS_ABOVE, _ERRORS_ABOVE + 10),
    _REST, _GAPS + 6, _GAPS + 7, *range(_REST + 1, _REST + 7),
)  # fmt: skip

_NEAR, _FAR = np.float32(2.0), np.float32(1.0 / 125.0)  # bounds of a predicted inverse range, 1/m
_ZERO, _HALF, _ONE, _TWO = np.float32(0.0), np.float32(0.5), np.float32(1.0), np.float32(2.0)
_QUARTER, _EIGHTH, _FOUR = np.float32(0.25), np.float32(0.125), np.float32(4.0)
_UNIT = np.float32(1.0 / 16.0)  # of a difference, per count
_SCALE, _LIMIT = np.float32(SCALE), np.float32(LIMIT)
_SLOT_DECAY = np.float32(1.0 / 16.0)
_GAP = np.float32(8.0)
_WIDE, _TIGHT = np.float32(0.02), np.float32(0.001)  # tolerances of the planes, of the inverse range
_WIDE_UP = np.float32(0.05)
_NOISE = np.float32(0.02)  # and of its square, m
NO_ERROR = np.float32(1.5)
_START = np.float32(0.05)

F32 = NDArray[np.float32]
I16 = NDArray[np.int16]
I32 = NDArray[np.int32]


class RingAbove(NamedTuple):
    """A ring above as the returns of the current one see it; meaningless where ``there`` is not.

    Attributes:
        frame, inverse: ``(size,)`` azimuths in ticks in the frame of the current laser, inverse ranges.
        error: ``(size, 16)`` squashed errors of the predictors at its returns.
        near, value: ``(size,)`` by return of the current ring: its return before that, its inverse range there.
        there: whether it has returns.
    """

    frame: F32
    inverse: F32
    error: F32
    near: I32
    value: F32
    there: bool


class Laser(NamedTuple):
    """What is the same for all returns of a ring: ``quotient / w - offset`` are counts, ``step`` the feature of the step.

    ``height2`` is the elevation step to the ring above the one above, in units of that to the one above.
    """

    quotient: np.float32
    offset: np.float32
    height2: np.float32
    step: np.float32


class Slots(NamedTuple):
    """What :func:`slot_places` and :func:`ring_gaps` make of a ring: ``(LEFT + 1, 32)`` and ``(size, GAPS)``."""

    places: F32
    gaps: I16


@inline
def squash(x: Lanes) -> Lanes:
    """Compress: odd, linear near 0, growing like the fourth root."""
    a = x / root(size(x) + _ONE)
    return a / root(size(a) + _ONE)


@inline
def rounded(x: Lanes) -> Lanes:
    """Turn features into inputs of the network, int16."""
    return cast(whole(larger(smaller(x * _SCALE + _HALF, _LIMIT), -_LIMIT)), np.int16)


@inline
def slot_places(has1: bool, has2: bool, places: F32) -> None:
    """Fill ``(LEFT + 1, 32)`` weights of the slots by how many returns there are to the left, before nearness."""
    for n in range(LEFT + 1):
        for k in range(32):
            if k < LEFT:
                there = k >= LEFT - n
            elif k < LEFT + UPPER:
                there = has1
            else:
                there = has2 and k < LEFT + UPPER + SECOND
            places[n, k] = _ZERO if not there else _ONE if k < LEFT + UPPER else _HALF


@inline
def ring_gaps(m: int, azimuth: F32, above: RingAbove, second: RingAbove, gaps: I16) -> None:
    """Fill the features of all ``m`` returns of a ring that do not depend on ranges, ``gaps`` (m, GAPS)."""
    for i in range(m):
        c = PAD + i
        a = azimuth[c]
        before = (a - azimuth[c - 1]) * _HALF - _ONE if i > 0 else _GAP
        after = (azimuth[c + 1] - a) * _HALF - _ONE if i + 1 < m else _ZERO
        then = (azimuth[c + 2] - azimuth[c + 1]) * _HALF - _ONE if i + 2 < m else _ZERO
        j1, j2 = above.near[i], second.near[i]
        left = (a - above.frame[j1]) * _HALF if above.there else _GAP
        right = (above.frame[j1 + 1] - a) * _HALF if above.there else _GAP
        apart = (second.frame[j2 + 1] - second.frame[j2]) * _HALF - _ONE if second.there else _GAP
        x = squash(of(before, after, left, right, apart, then, _ZERO, _ZERO))
        there = of(_ONE if above.there else _ZERO, _ONE if second.there else _ZERO)
        store(gaps, i * GAPS, rounded(splice(x, join(join(there, there), join(there, there)), 6)))


@inline
def point_features(i, azimuth, left, first, second, laser, slots, error0, x):  # type: ignore[no-untyped-def]
    """Fill the inputs ``x`` (END,) of return i and return its predictions.

    Rings stand at ``[PAD, PAD + n)``.

    Args:
        left: eight lanes, inverse ranges of the returns to the left, the nearest last.
        first, second: :class:`RingAbove`, the one above that.
        laser, slots: :class:`Laser`, :class:`Slots`.
        error0: lanes, the running squashed errors of the predictors to the left.

    Returns:
        w1, the base plane's height over it and slopes, and the base: what :mod:`.previous_features` needs; and the
        predicted counts, PREDICTORS of 16 lanes.
    """
    c = PAD + i
    a = azimuth[c]
    n_left = min(i, LEFT)
    if i > 0:
        w1 = lane(left, 7)
    elif first.there:
        w1 = first.value[i]
    else:
        w1 = _START
    up = first.value[i] if first.there else w1
    top = second.value[i] if second.there else up
    shift1 = up - w1
    shift2 = top - w1
    j1, j2 = first.near[i], second.near[i]
    o1, o2 = j1 - UPPER // 2 + 1, j2 - SECOND // 2 + 1
    u = (around(load(azimuth, c - LEFT, 8), first.frame, o1, second.frame, o2) - a) * _HALF
    d = around(left, first.inverse, o1, second.inverse, o2) - w1
    uu, ud = u * u, u * d
    place = load(slots.places, n_left * 32, 32)
    present = place > _ZERO
    place = place / (uu * _SLOT_DECAY + _ONE)
    noise = _NOISE * w1 * w1
    plane_up, _, _, sum_up = fit_plane(
        weigh(place, d - shift1, _ONE / (_WIDE_UP * w1 + noise)), u, uu, d, ud, laser.height2
    )
    plane_left, slope_u, slope_v, sum_left = fit_plane(
        weigh(place, d, _ONE / (_WIDE * w1 + noise)), u, uu, d, ud, laser.height2
    )
    off = residuals(u, d, laser.height2, plane_left, slope_u, slope_v)
    tight, slope_u, slope_v, sum_tight = fit_plane(
        weigh(place, off, _ONE / (_TIGHT * w1 + noise)), u, uu, d, ud, laser.height2
    )
    base = min(max(w1 + tight, _FAR), _NEAR)

    d2, d4 = lane(d, LEFT - 2), lane(d, LEFT - 4)
    along, bent, moved, mean = w1, w1, w1, up
    if i >= 2:
        span = max(azimuth[c - 1] - azimuth[c - 2], _ONE)
        along = w1 - d2 * ((a - azimuth[c - 1]) / span)
    if i >= 4:
        bent = w1 + (d2 - d4) * _HALF
    if i >= 1 and first.there:
        moved = w1 + (up - first.value[i - 1])
    if i >= 4 and first.there:
        g = (d2 + lane(d, LEFT - 3)) + d4
        v = (first.value[i - 1] + first.value[i - 2]) + (first.value[i - 3] + first.value[i - 4])
        mean = w1 + (up + (g - v) * _QUARTER)
    over = up + (up - top) / max(laser.height2 - _ONE, _QUARTER)
    guesses = of(
        w1, along, bent, up, moved, over, mean, w1 + plane_up, w1 + plane_left, base, w1, w1, w1, w1, w1, w1
    )  # fmt: skip
    counts = laser.quotient / larger(smaller(guesses, _NEAR), _FAR) - laser.offset
    per_w = laser.quotient / (base * base) * _UNIT  # counts fall by quotient / base^2 per unit of w
    off = residuals(u, d, laser.height2, tight, slope_u, slope_v) * per_w
    store(x, _RESIDUALS, rounded(squash(choose(present, off, spread(_ZERO, 32)))))
    others = of(
        _ZERO, _ZERO, _ZERO, _ZERO, _ZERO, _ZERO, _ZERO, _ZERO, _ZERO,
        slope_u * per_w, slope_v * per_w, shift1 * per_w, shift2 * per_w, _ZERO, _ZERO, _ZERO,
    )  # fmt: skip
    store(x, _OFFSETS, rounded(squash(splice((counts - lane(counts, 9)) * _UNIT, others, 9))))
    store(x, _GAPS, load(slots.gaps, i * GAPS, GAPS))
    store(x, _ERRORS, rounded(error0))
    above = spread(NO_ERROR, 16)
    if first.there:
        above = (load(first.error, j1 * 16, 16) + load(first.error, j1 * 16 + 16, 16)) * _HALF
    store(x, _ERRORS_ABOVE, rounded(above))
    rest = of(
        np.float32(n_left) * _EIGHTH, np.sqrt(_ONE / base) * _HALF, np.sqrt(base) * _FOUR, laser.step,
        sum_tight * _QUARTER, sum_left * _QUARTER, sum_up * _QUARTER, _ZERO,
    )  # fmt: skip
    store(x, _REST, rounded(rest))
    return w1, tight, slope_u, slope_v, base, counts


@inline
def squashed_errors(actual: np.float32, counts: Lanes) -> Lanes:
    """How far each predictor was from ``actual`` counts, for the features of later returns."""
    e = size(counts - actual) * _UNIT
    e = e / root(e + _ONE)
    return e / root(e + _ONE)
