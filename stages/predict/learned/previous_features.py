"""What the sweep before says about one return: three more predictors and their features, and intensities.

Effort ``max`` only. The layout and the exact arithmetic are those of :mod:`.range_features`; slots are the points of
three rows of the :mod:`warped sweep <.previous_sweep>` around the return, on its own row, the one above and the
one below.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.predict.learned import intensity_features as intensities
from salpcc.stages.predict.learned import range_features as features
from salpcc.stages.predict.learned.previous_sweep import WarpedSweep
from salpcc.stages.predict.learned.range_features import NO_ERROR, rounded, squash
from salpcc.stages.predict.learned.range_features import PREDICTORS as OF_SWEEP
from salpcc.stages.predict.ring_rows import PAD, align
from salpcc.stages.vectors import (
    Lanes,
    choose,
    inline,
    join,
    lane,
    load,
    of,
    pick,
    size,
    splice,
    spread,
    store,
    totals,
)

OWN, NEXT = 6, 4
SLOTS = OWN + 2 * NEXT
LANES = 16
INPUTS = 32  # more than those of features
PREDICTORS = 3
INTENSITY_INPUTS = 24
NO_VALUE = 101  # row of the table of intensities where there is no sweep before

# Where the features stand among the inputs of a network, behind those of one that does not look back.
_RESIDUALS, _OFFSETS, _REST = features.END, features.END + 16, features.END + 24
INPUT_PLACES = (*features.INPUT_PLACES, *(features.END + n for n in (*range(14), *range(16, 34))))
END = features.END + 36
INTENSITY_PLACES = (*intensities.INPUT_PLACES, *range(intensities.END, intensities.END + INTENSITY_INPUTS))
INTENSITY_END = intensities.END + INTENSITY_INPUTS

_ZERO, _HALF, _ONE, _TWO = np.float32(0.0), np.float32(0.5), np.float32(1.0), np.float32(2.0)
_UNIT = np.float32(1.0 / 16.0)
_NEAR, _FAR = np.float32(2.0), np.float32(1.0 / 125.0)
_SPREAD = np.float32(0.3)  # of the weights: squared firings
_ROW = np.float32(4.0)  # a row is two firings apart
_GAP = np.float32(8.0)
_PER_STEP = np.float32(1.0 / 12.5)
_LITTLE, _TINY = np.float32(1e-3), np.float32(1e-6)

F32 = NDArray[np.float32]
I32 = NDArray[np.int32]


class Seen(NamedTuple):
    """The rows k - 1, k, k + 1 of the sweep before, aligned with each ring k.

    Attributes:
        frames: ``(3 L, size)`` azimuths of their points in the frame of ring k, in ticks; row 3 k + 1 is of its own row.
        indices: ``(3 L, returns)`` of the point before each return of ring k.
        there: ``(L, LANES)`` 1 for the slots of rows that have points.
        weights, values: ``(LANES,)`` scratch.
    """

    frames: F32
    indices: I32
    there: F32
    weights: F32
    values: F32


@njit(error_model="numpy", nogil=True)
def see(before: WarpedSweep, starts: NDArray[np.int64], azimuth: F32, constants: F32) -> Seen:
    """Align the rows of the sweep before with all rings."""
    n_rings = len(starts) - 1
    frames = np.zeros((3 * n_rings, before.azimuth.shape[1]), np.float32)
    indices = np.full((3 * n_rings, azimuth.shape[1]), PAD, np.int32)
    there = np.zeros((n_rings, LANES), np.float32)
    for k in range(n_rings):
        m = starts[k + 1] - starts[k]
        for r in range(3):
            row = k - 1 + r
            if row < 0 or row >= n_rings or before.number[row] == 0:
                continue
            first = 0 if r == 0 else NEXT if r == 1 else NEXT + OWN
            there[k, first : first + (OWN if r == 1 else NEXT)] = _ONE
            align(
                before.azimuth[row], before.inverse[row], before.number[row], -constants[k, 4], azimuth[k], m,
                frames[3 * k + r], indices[3 * k + r],
            )  # fmt: skip
    return Seen(frames, indices, there, np.zeros(LANES, np.float32), np.zeros(LANES, np.float32))


@inline
def _slots(i: int, k: int, rows: F32, row: int, indices: I32) -> Lanes:
    """Lanes of the points around return i of ring k: four of the row before ``row``, six of that, four of the one after it."""
    last = rows.shape[0] - 1
    width = rows.shape[1]
    up, own, down = max(row - 1, 0) * width, row * width, min(row + 1, last) * width
    at, to = np.uint64(3 * k), np.uint64(i)
    own += indices[at + np.uint64(1), to] - OWN // 2 + 1
    first = splice(load(rows, up + indices[at, to] - 1, 8), load(rows, own - 4, 8), 4)
    second = splice(load(rows, own + 4, 8), load(rows, down + indices[at + np.uint64(2), to] - 3, 8), 2)
    return join(first, second)


@inline
def gather(i, k, a, before, seen):  # type: ignore[no-untyped-def]
    """Return U, V, inverse range, weight and intensity of the points around return i of ring k, at azimuth a.

    U in firings (two ticks), V in rows; weight 0 where there is no point. ``before`` is a :class:`.previous_sweep.WarpedSweep`,
    ``seen`` a :class:`Seen`.
    """
    some = load(seen.there, k * LANES, 16) > _ZERO
    nothing = spread(_ZERO, 16)
    cone = before.cones[k]
    w = choose(some, _slots(i, k, before.inverse, k, seen.indices), spread(_ONE, 16))
    u = choose(some, (_slots(i, k, seen.frames, 3 * k + 1, seen.indices) - a) * _HALF, nothing)
    v = choose(
        some, (_slots(i, k, before.height, k, seen.indices) - w * cone[0] - cone[1]) * cone[2], nothing
    )
    value = choose(some, _slots(i, k, before.intensity, k, seen.indices), spread(intensities.NONE, 16))
    q = u * u + v * v * _ROW + _SPREAD
    return u, v, w, choose(some, _ONE / (q * q), nothing), value


@inline
def previous_features(  # type: ignore[no-untyped-def]
    w1, tight, slope_u, slope_v, base, laser, slots, before, error0, above, at, errors, x, to, counts
):
    """Fill the inputs from ``x[to + features.END]`` on; return ``counts`` with PREDICTORS more of its lanes filled.

    Residuals are those of the slots to the base plane of :func:`.range_features.point_features`, in units of 16 counts. The
    predictors: the base plane moved by the residuals' mean, weighted by nearness; the same, robust; the first,
    moved by its own error at the return to the left, ``before``. ``above``: whether there is a ring above, with errors of its
    return there from flat index ``at`` of ``errors`` on.
    """
    u, v, w, weight, _ = slots
    per_w = laser.quotient / (base * base) * _UNIT
    some = weight > _ZERO
    r = choose(some, ((w - w1) - ((v * slope_v + tight) + u * slope_u)) * per_w, spread(_ZERO, 16))
    q = r * r + _ONE
    robust = weight / (q * q)
    sums = totals(weight, weight * r, robust, robust * r)
    total, robust_total = lane(sums, 0) + _TINY, lane(sums, 2) + _TINY
    near, robust_near = lane(sums, 1) / total, lane(sums, 3) / robust_total
    apart = lane(totals(weight * size(r - near)), 0)
    centre = lane(counts, OF_SWEEP - 1)
    slope = _ONE / per_w
    first = laser.quotient / min(max(base + near * slope, _FAR), _NEAR) - laser.offset
    second = laser.quotient / min(max(base + robust_near * slope, _FAR), _NEAR) - laser.offset
    own = lane(weight, NEXT) > _ZERO
    store(x, to + _RESIDUALS, rounded(squash(r)))
    others = of(
        (first - centre) * _UNIT,
        (second - centre) * _UNIT,
        before * _UNIT,
        lane(u, NEXT + OWN // 2 - 1) if own else -_GAP,
        lane(u, NEXT + OWN // 2) if own else _GAP,
        lane(v, NEXT + OWN // 2 - 1),
        lane(v, NEXT + OWN // 2),
        apart / total,
    )
    store(x, to + _OFFSETS, rounded(squash(others)))
    over = spread(NO_ERROR, 16)
    if above:
        over = (load(errors, at, 16) + load(errors, at + 16, 16)) * _HALF
    rest = of(
        lane(error0, 10), lane(error0, 11), lane(error0, 12), lane(over, 10), lane(over, 11), lane(over, 12),
        total / (total + _ONE), robust_total / (total + _ONE), _ONE if own else _ZERO,
        _ZERO, _ZERO, _ZERO, _ZERO, _ZERO, _ZERO, _ZERO,
    )  # fmt: skip
    store(x, to + _REST, rounded(rest))
    more = of(
        _ZERO, _ZERO, _ZERO, _ZERO, _ZERO, _ZERO, _ZERO, _ZERO, _ZERO, _ZERO,
        first, second, first + before, centre, lane(counts, 0), _ZERO,
    )  # fmt: skip
    return splice(counts, more, OF_SWEEP)


@inline
def previous_intensity(w0, quotient, slots, seen, activity, bias, x, to):  # type: ignore[no-untyped-def]
    """Fill the inputs from ``x[to + intensity_features.END]`` on; of ``seen``, weights and values are scratch.

    Returns the intensity of the nearest slot, in azimuth, elevation and range together, and the
    weighted mean.
    """
    _, _, w, weight, value = slots
    per_w = quotient / (w0 * w0) * _UNIT
    r = (w - w0) * per_w
    q = r * _HALF
    weight = weight / (q * q + _ONE)
    store(seen.weights, 0, weight)
    store(seen.values, 0, value)
    most, best = _ZERO, NO_VALUE
    for s in range(SLOTS):
        if seen.weights[s] > most:
            most = seen.weights[s]
            best = int(seen.values[s])
    sums = totals(weight, weight * value)
    total = lane(sums, 0) + _LITTLE
    mean = (lane(sums, 1) + _LITTLE * intensities.NONE) / total
    apart = lane(totals(weight * size(value - mean)), 0)
    near = pick(choose(weight > _ZERO, r, spread(_GAP, 16)), 1, 2, 5, 6, 7, 8, 11, 12)
    shown = pick(value, 1, 2, 5, 6, 7, 8, 11, 12) * _PER_STEP
    rest = of(
        mean * _PER_STEP, apart / total * _PER_STEP * _TWO, activity * _PER_STEP * _TWO, bias * _PER_STEP * _TWO,
        total / (total + _ONE), _ONE if seen.weights[NEXT] > _ZERO else _ZERO, most / (most + _ONE), _ZERO,
    )  # fmt: skip
    store(x, to + intensities.END, rounded(squash(near)))
    store(x, to + intensities.END + 8, rounded(shown))
    store(x, to + intensities.END + 16, rounded(rest))
    return best, mean
