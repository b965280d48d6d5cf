"""Predictors and features of one return's range, from the returns coded before it.

Everything lives in inverse horizontal range ``w = 1 / rho'``, where a plane is linear in azimuth and
in the tangent of the elevation (docs/sensor_lattice.md, section 3). Rings are coded top first, returns by
rising tick. The lever arm of docs/sensor_lattice.md, section 1, shifts what a laser sees at a given tick,
so the rings above are first moved into the tick frame of the current laser.

The decoder repeats all of this, hence only float64 and float32 with ``+ - * /`` and square roots, in
a fixed order: the same bits on every machine (docs/sensor_lattice.md, section 4).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from salpcc.stages.predict.learned.local_plane import LEFT, SECOND, UPPER, around, fit_plane, residuals, weigh
from salpcc.stages.predict.learned.vectors import (
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
from salpcc.stages.predict.ring_rows import PAD

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
def ring_gaps(
    m: int,
    azimuth: F32,
    frame1: F32,
    index1: I32,
    has1: bool,
    frame2: F32,
    index2: I32,
    has2: bool,
    gaps: I16,
) -> None:
    """Fill the features of all ``m`` returns of a ring that do not depend on ranges, ``gaps`` (m, GAPS)."""
    for i in range(m):
        c = PAD + i
        a = azimuth[c]
        before = (a - azimuth[c - 1]) * _HALF - _ONE if i > 0 else _GAP
        after = (azimuth[c + 1] - a) * _HALF - _ONE if i + 1 < m else _ZERO
        then = (azimuth[c + 2] - azimuth[c + 1]) * _HALF - _ONE if i + 2 < m else _ZERO
        j1, j2 = index1[i], index2[i]
        left = (a - frame1[j1]) * _HALF if has1 else _GAP
        right = (frame1[j1 + 1] - a) * _HALF if has1 else _GAP
        second = (frame2[j2 + 1] - frame2[j2]) * _HALF - _ONE if has2 else _GAP
        x = squash(of(before, after, left, right, second, then, _ZERO, _ZERO))
        there = of(_ONE if has1 else _ZERO, _ONE if has2 else _ZERO)
        store(gaps, i * GAPS, rounded(splice(x, join(join(there, there), join(there, there)), 6)))


@inline
def point_features(  # type: ignore[no-untyped-def]
    i, azimuth, left, frame1, inverse1, error1, index1, value1, has1, frame2, inverse2, index2, value2, has2,
    height2, quotient, offset, step, places, gaps, error0, x,
):  # fmt: skip
    """Fill the inputs ``x`` (END,) of return i and return its predictions.

    Rings stand at ``[PAD, PAD + n)``; 1 is the ring above, 2 the one above that. ``height2`` is the
    second ring's elevation step in units of the first's. ``quotient / w - offset`` are counts.

    Args:
        left: eight lanes, inverse ranges of the returns to the left, the nearest last.
        error0: lanes, the running squashed errors of the predictors to the left; ``error1`` (size, 16) those at each
            return above.
        places, gaps: what :func:`slot_places` and :func:`ring_gaps` made.

    Returns:
        w1, the base plane's height over it and slopes, and the base: what :mod:`.previous_features` needs; and the
        predicted counts, PREDICTORS of 16 lanes.
    """
    c = PAD + i
    a = azimuth[c]
    n_left = min(i, LEFT)
    if i > 0:
        w1 = lane(left, 7)
    elif has1:
        w1 = value1[i]
    else:
        w1 = _START
    up = value1[i] if has1 else w1
    second = value2[i] if has2 else up
    shift1 = up - w1
    shift2 = second - w1
    j1, j2 = index1[i], index2[i]
    o1, o2 = j1 - UPPER // 2 + 1, j2 - SECOND // 2 + 1
    u = (around(load(azimuth, c - LEFT, 8), frame1, o1, frame2, o2) - a) * _HALF
    d = around(left, inverse1, o1, inverse2, o2) - w1
    uu, ud = u * u, u * d
    place = load(places, n_left * 32, 32)
    present = place > _ZERO
    place = place / (uu * _SLOT_DECAY + _ONE)
    noise = _NOISE * w1 * w1
    plane_up, _, _, sum_up = fit_plane(
        weigh(place, d - shift1, _ONE / (_WIDE_UP * w1 + noise)), u, uu, d, ud, height2
    )
    plane_left, slope_u, slope_v, sum_left = fit_plane(
        weigh(place, d, _ONE / (_WIDE * w1 + noise)), u, uu, d, ud, height2
    )
    off = residuals(u, d, height2, plane_left, slope_u, slope_v)
    tight, slope_u, slope_v, sum_tight = fit_plane(
        weigh(place, off, _ONE / (_TIGHT * w1 + noise)), u, uu, d, ud, height2
    )
    base = min(max(w1 + tight, _FAR), _NEAR)

    d2, d4 = lane(d, LEFT - 2), lane(d, LEFT - 4)
    along, bent, moved, mean = w1, w1, w1, up
    if i >= 2:
        span = max(azimuth[c - 1] - azimuth[c - 2], _ONE)
        along = w1 - d2 * ((a - azimuth[c - 1]) / span)
    if i >= 4:
        bent = w1 + (d2 - d4) * _HALF
    if i >= 1 and has1:
        moved = w1 + (up - value1[i - 1])
    if i >= 4 and has1:
        g = (d2 + lane(d, LEFT - 3)) + d4
        v = (value1[i - 1] + value1[i - 2]) + (value1[i - 3] + value1[i - 4])
        mean = w1 + (up + (g - v) * _QUARTER)
    over = up + (up - second) / max(height2 - _ONE, _QUARTER)
    guesses = of(
        w1, along, bent, up, moved, over, mean, w1 + plane_up, w1 + plane_left, base, w1, w1, w1, w1, w1, w1
    )  # fmt: skip
    counts = quotient / larger(smaller(guesses, _NEAR), _FAR) - offset
    per_w = quotient / (base * base) * _UNIT  # counts fall by quotient / base^2 per unit of w
    off = residuals(u, d, height2, tight, slope_u, slope_v) * per_w
    store(x, _RESIDUALS, rounded(squash(choose(present, off, spread(_ZERO, 32)))))
    others = of(
        _ZERO, _ZERO, _ZERO, _ZERO, _ZERO, _ZERO, _ZERO, _ZERO, _ZERO,
        slope_u * per_w, slope_v * per_w, shift1 * per_w, shift2 * per_w, _ZERO, _ZERO, _ZERO,
    )  # fmt: skip
    store(x, _OFFSETS, rounded(squash(splice((counts - lane(counts, 9)) * _UNIT, others, 9))))
    store(x, _GAPS, load(gaps, i * GAPS, GAPS))
    store(x, _ERRORS, rounded(error0))
    above = spread(NO_ERROR, 16)
    if has1:
        above = (load(error1, j1 * 16, 16) + load(error1, j1 * 16 + 16, 16)) * _HALF
    store(x, _ERRORS_ABOVE, rounded(above))
    rest = of(
        np.float32(n_left) * _EIGHTH, np.sqrt(_ONE / base) * _HALF, np.sqrt(base) * _FOUR, step,
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
