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
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.predict.learned.local_plane import (
    LEFT,
    SECOND,
    UPPER,
    fit_plane,
    heights,
    residuals,
    slots_around,
    weigh,
)
from salpcc.stages.predict.ring_rows import PAD
from salpcc.stages.vectors import (
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


class Rings(NamedTuple):
    """All rings of a sweep, each at ``[PAD, PAD + n)`` of its row of ``size`` places, margins cyclic on the right, on the left more of the first return.

    Attributes:
        azimuth, inverse: ``(L, size)`` in ticks, inverse horizontal ranges in 1/m.
        error: ``(L, size, 16)`` squashed errors of the predictors.
        above, second: ``(L, size)`` azimuths of the ring above and of the one above that, in the frame of the ring.
        value: ``(L, size)`` inverse range of the ring above at the ring's own returns.
    """

    azimuth: F32
    inverse: F32
    error: F32
    above: F32
    second: F32
    value: F32


class Laser(NamedTuple):
    """What is the same for all returns of a ring: ``quotient / w - offset`` are counts, ``step`` the feature of the step.

    ``height2`` is the elevation step to the ring above the one above, in units of that to the one above.
    """

    quotient: np.float32
    offset: np.float32
    height2: np.float32
    step: np.float32


class Around(NamedTuple):
    """Where a return stands and what is above it.

    Attributes:
        ring, i: return i of a ring.
        above, second: whether the ring above, and the one above that, have returns.
        near, near2: places of their last returns that are not after it.
        value2: inverse range of the second ring there.
    """

    ring: int
    i: int
    above: bool
    second: bool
    near: int
    near2: int
    value2: np.float32


@inline
def squash(x: Lanes) -> Lanes:
    """Compress: odd, linear near 0, growing like the fourth root."""
    a = size(x)
    r = root(a + _ONE)
    return x / root(r * (r + a))  # y / sqrt(|y| + 1) of y = x / sqrt(|x| + 1), with one division


@inline
def rounded(x: Lanes) -> Lanes:
    """Turn features into inputs of the network, int16."""
    return cast(whole(larger(smaller(x * _SCALE + _HALF, _LIMIT), -_LIMIT)), np.int16)


@njit(cache=True, error_model="numpy")
def slot_places() -> F32:
    """Return ``(3, LEFT + 1, 32)`` weights of the slots, before nearness, by how many rings and how many returns to the left there are."""
    places = np.zeros((3, LEFT + 1, 32), np.float32)
    for above in range(3):
        for n in range(LEFT + 1):
            places[above, n, LEFT - n : LEFT] = _ONE
            if above > 0:
                places[above, n, LEFT : LEFT + UPPER] = _ONE
            if above > 1:
                places[above, n, LEFT + UPPER : LEFT + UPPER + SECOND] = _HALF
    return places


@inline
def _gaps(at: int, a: np.float32, n: int, around: Around, rings: Rings) -> Lanes:
    """Features of a return at flat index ``at``, azimuth ``a``, of a ring of ``n`` that do not depend on ranges to the left."""
    azimuths = load(rings.azimuth, at - 1, 4)
    before = (a - lane(azimuths, 0)) * _HALF - _ONE if around.i > 0 else _GAP
    after = (lane(azimuths, 2) - a) * _HALF - _ONE if around.i + 1 < n else _ZERO
    then = (lane(azimuths, 3) - lane(azimuths, 2)) * _HALF - _ONE if around.i + 2 < n else _ZERO
    row = around.ring * rings.azimuth.shape[1]
    above, second = load(rings.above, row + around.near, 2), load(rings.second, row + around.near2, 2)
    left = (a - lane(above, 0)) * _HALF if around.above else _GAP
    right = (lane(above, 1) - a) * _HALF if around.above else _GAP
    apart = (lane(second, 1) - lane(second, 0)) * _HALF - _ONE if around.second else _GAP
    x = squash(of(before, after, left, right, apart, then, _ZERO, _ZERO))
    there = of(_ONE if around.above else _ZERO, _ONE if around.second else _ZERO)
    return rounded(splice(x, join(join(there, there), join(there, there)), 6))


@inline
def point_features(around, n, rings, laser, places, error0, x, to):  # type: ignore[no-untyped-def]
    """Fill the inputs of a return, from flat index ``to`` of ``x``, and return its predictions.

    Args:
        around: :class:`Around`, in a ring of ``n``.
        rings: :class:`Rings`.
        laser, places: :class:`Laser`, of :func:`slot_places`.
        error0: lanes, the running squashed errors of the predictors to the left.

    Returns:
        w1, the base plane's height over it and slopes, and the base: what :mod:`.previous_features` needs; and the
        predicted counts, PREDICTORS of 16 lanes.
    """
    i, size = around.i, rings.azimuth.shape[1]
    row = around.ring * size
    row1, row2 = max(row - size, 0), max(row - 2 * size, 0)
    c = row + PAD + i
    left, azimuths = load(rings.inverse, c - LEFT, 8), load(rings.azimuth, c - LEFT, 8)
    a = rings.azimuth[np.uint64(around.ring), np.uint64(PAD + i)]
    values = load(rings.value, c - 4, 8)
    n_left = min(i, LEFT)
    if i > 0:
        w1 = lane(left, 7)
    elif around.above:
        w1 = lane(values, 4)
    else:
        w1 = _START
    up = lane(values, 4) if around.above else w1
    top = around.value2 if around.second else up
    shift1 = up - w1
    shift2 = top - w1
    o1, o2 = around.near - UPPER // 2 + 1, around.near2 - SECOND // 2 + 1
    u = (slots_around(azimuths, rings.above, row + o1, rings.second, row + o2) - a) * _HALF
    d = slots_around(left, rings.inverse, row1 + o1, rings.inverse, row2 + o2) - w1
    uu, ud = u * u, u * d
    known = int(around.above) + int(around.second)
    place = load(places, (known * (LEFT + 1) + n_left) * 32, 32)
    present = place > _ZERO
    far = uu * _SLOT_DECAY + _ONE
    v = heights(laser.height2)
    noise = _NOISE * w1 * w1
    plane_up, _, _, sum_up = fit_plane(
        weigh(place, far, d - shift1, _ONE / (_WIDE_UP * w1 + noise)), u, uu, v, d, ud
    )
    plane_left, slope_u, slope_v, sum_left = fit_plane(
        weigh(place, far, d, _ONE / (_WIDE * w1 + noise)), u, uu, v, d, ud
    )
    off = residuals(u, v, d, plane_left, slope_u, slope_v)
    tight, slope_u, slope_v, sum_tight = fit_plane(
        weigh(place, far, off, _ONE / (_TIGHT * w1 + noise)), u, uu, v, d, ud
    )
    base = min(max(w1 + tight, _FAR), _NEAR)

    d2, d4 = lane(d, LEFT - 2), lane(d, LEFT - 4)
    along, bent, moved, mean = w1, w1, w1, up
    if i >= 2:
        span = max(lane(azimuths, 7) - lane(azimuths, 6), _ONE)
        along = w1 - d2 * ((a - lane(azimuths, 7)) / span)
    if i >= 4:
        bent = w1 + (d2 - d4) * _HALF
    if i >= 1 and around.above:
        moved = w1 + (up - lane(values, 3))
    if i >= 4 and around.above:
        g = (d2 + lane(d, LEFT - 3)) + d4
        h = (lane(values, 3) + lane(values, 2)) + (lane(values, 1) + lane(values, 0))
        mean = w1 + (up + (g - h) * _QUARTER)
    over = up + (up - top) / max(laser.height2 - _ONE, _QUARTER)
    guesses = of(
        w1, along, bent, up, moved, over, mean, w1 + plane_up, w1 + plane_left, base, w1, w1, w1, w1, w1, w1
    )  # fmt: skip
    counts = laser.quotient / larger(smaller(guesses, _NEAR), _FAR) - laser.offset
    per_w = laser.quotient / (base * base) * _UNIT  # counts fall by quotient / base^2 per unit of w
    off = residuals(u, v, d, tight, slope_u, slope_v) * per_w
    store(x, to + _RESIDUALS, rounded(squash(choose(present, off, spread(_ZERO, 32)))))
    others = of(
        _ZERO, _ZERO, _ZERO, _ZERO, _ZERO, _ZERO, _ZERO, _ZERO, _ZERO,
        slope_u * per_w, slope_v * per_w, shift1 * per_w, shift2 * per_w, _ZERO, _ZERO, _ZERO,
    )  # fmt: skip
    store(x, to + _OFFSETS, rounded(squash(splice((counts - lane(counts, 9)) * _UNIT, others, 9))))
    store(x, to + _GAPS, _gaps(c, a, n, around, rings))
    store(x, to + _ERRORS, rounded(error0))
    above = spread(NO_ERROR, 16)
    if around.above:
        at = (row1 + around.near) * 16
        above = (load(rings.error, at, 16) + load(rings.error, at + 16, 16)) * _HALF
    store(x, to + _ERRORS_ABOVE, rounded(above))
    rest = of(
        np.float32(n_left) * _EIGHTH, np.sqrt(_ONE / base) * _HALF, np.sqrt(base) * _FOUR, laser.step,
        sum_tight * _QUARTER, sum_left * _QUARTER, sum_up * _QUARTER, _ZERO,
    )  # fmt: skip
    store(x, to + _REST, rounded(rest))
    return w1, tight, slope_u, slope_v, base, counts


@inline
def squashed_errors(actual: np.float32, counts: Lanes) -> Lanes:
    """How far each predictor was from ``actual`` counts, for the features of later returns."""
    return squash(size(counts - actual) * _UNIT)
