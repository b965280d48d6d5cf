"""Features of one return's intensity: neighbours' intensities and the whole sweep's ranges.

Ranges are coded first, so ranges of the returns to the right and below are known too. Same exact
arithmetic and layout as :mod:`salpcc.stages.predict.learned.range_features`.

Slots are lanes 2 to 19 of a vector of 32: six returns to the left on the current ring, eight of the ring above, four
of the one above that. Lanes 20 to 23 are returns of the ring below, 24 to 26 those to the right: only ranges.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.predict.learned.range_features import rounded, squash
from salpcc.stages.predict.ring_rows import PAD
from salpcc.stages.vectors import (
    Lanes,
    choose,
    inline,
    join,
    lane,
    load,
    of,
    splice,
    spread,
    store,
    totals,
)
from salpcc.stages.vectors import size as size_of

LEFT = 6
INPUTS = 56
NONE = np.float32(25.0)  # intensity of a return that is not there

# Where the features stand among the inputs of the network.
_RANGES, _GAPS, _VALUES, _REST, END = 0, 28, 34, 54, 64
# That place for each input of the network as trained.
INPUT_PLACES = (
    *range(_RANGES + 2, _RANGES + 20),
    *range(_RANGES + 24, _RANGES + 27),
    *range(_RANGES + 20, _RANGES + 24),
    *range(_GAPS, _GAPS + 4),
    *range(_VALUES + 2, _VALUES + 20),
    *range(_REST, _REST + 5),
    _GAPS + 4, _REST + 5, _REST + 6, _GAPS + 5,
)  # fmt: skip

_ZERO, _HALF, _ONE, _TWO = np.float32(0.0), np.float32(0.5), np.float32(1.0), np.float32(2.0)
_QUARTER, _EIGHTH, _FOUR = np.float32(0.25), np.float32(0.125), np.float32(4.0)
_UNIT = np.float32(1.0 / 16.0)
_PER_STEP = np.float32(1.0 / 12.5)
_GAP = np.float32(8.0)
_LITTLE = np.float32(1e-3)

F32 = NDArray[np.float32]
I16 = NDArray[np.int16]
I32 = NDArray[np.int32]


class Rings(NamedTuple):
    """All rings of a sweep, each at ``[PAD, PAD + n)`` of its row of ``size`` places, margins cyclic; on the left, intensities are the first return's.

    Attributes:
        azimuth, inverse, intensity: ``(L, size)`` in ticks, inverse ranges, 0..100 where it is known.
        above: ``(L, size)`` azimuths of the ring above in the frame of the ring.
        near: ``(3 L, size)``: rows 3 k, 3 k + 1, 3 k + 2 are places of the returns before those of ring k in rings k - 1, k - 2, k + 1.
    """

    azimuth: F32
    inverse: F32
    intensity: F32
    above: F32
    near: I32


class Around(NamedTuple):
    """Where a return stands, what is around it: return i of a ring, whether there are the rings k - 1, k - 2, k + 1, and its near places there."""

    ring: int
    i: int
    above: bool
    second: bool
    below: bool
    near: int
    near2: int
    near3: int


class Slots(NamedTuple):
    """Weights of the slots before nearness, and 1 where a range is known: ``(8, LEFT + 1, 32)`` both, by :func:`which`, and by how many returns there are to the left."""

    places: F32
    there: F32


@inline
def which(above: bool, second: bool, below: bool) -> int:
    """Return a number of the rings that are there."""
    return int(above) + 2 * int(second) + 4 * int(below)


@njit(cache=True, error_model="numpy")
def slot_places() -> Slots:
    """Return the slots' weights."""
    slots = Slots(np.zeros((8, LEFT + 1, 32), np.float32), np.zeros((8, LEFT + 1, 32), np.float32))
    for rings in range(8):
        for n in range(LEFT + 1):
            for k in range(32):
                weight, known = _ZERO, True
                if k < 8:
                    known = k >= 8 - n
                    weight = _ONE
                elif k < 16:
                    known = rings & 1 > 0
                    weight = _ONE if k == 11 or k == 12 else _HALF
                elif k < 20:
                    known = rings & 2 > 0
                    weight = _HALF
                elif k < 24:
                    known = rings & 4 > 0
                slots.places[rings, n, k] = weight if known else _ZERO
                slots.there[rings, n, k] = _ONE if known else _ZERO
    return slots


@inline
def _gaps(at: int, n: int, around: Around, rings: Rings) -> Lanes:
    """Features of a return at flat index ``at``, of a ring of ``n``, that depend on azimuths only."""
    azimuths = load(rings.azimuth, at - 1, 4)
    a = lane(azimuths, 1)
    above = load(rings.above, around.ring * rings.azimuth.shape[1] + around.near, 2)
    before = (a - lane(azimuths, 0)) * _HALF - _ONE if around.i > 0 else _GAP
    after = (lane(azimuths, 2) - a) * _HALF - _ONE if around.i + 1 < n else _GAP
    left = (a - lane(above, 0)) * _HALF if around.above else _GAP
    right = (lane(above, 1) - a) * _HALF if around.above else _GAP
    x = squash(of(before, after, left, right, _ZERO, _ZERO, _ZERO, _ZERO))
    there = of(_ONE if around.above else _ZERO, _ONE if around.second else _ZERO)
    return rounded(splice(x, join(join(there, there), join(there, there)), 4))


@inline
def intensity_features(around, n, rings, left, quotient, activity, slots, x, to):  # type: ignore[no-untyped-def]
    """Fill the inputs of a return, from flat index ``to`` of ``x``; return the two nearest intensities (left, above) and the local mean.

    ``around`` is an :class:`Around`, in a ring of ``n``, of :class:`Rings`; ``left`` are eight lanes of intensities to the
    left, the nearest last; ``slots`` :class:`Slots`.
    """
    size = rings.azimuth.shape[1]
    row = around.ring * size
    row1, row2, row3 = max(row - size, 0), max(row - 2 * size, 0), min(row + size, rings.azimuth.size - size)
    c = row + PAD + around.i
    inverse = rings.inverse
    w0 = inverse[np.uint64(around.ring), np.uint64(PAD + around.i)]
    per_w = quotient / (w0 * w0) * _UNIT
    n_left = min(around.i, LEFT)
    upper, top = row1 + around.near - 3, row2 + around.near2 - 1
    beside = join(
        join(load(inverse, c - 8, 8), load(inverse, upper, 8)),
        join(
            splice(load(inverse, top, 8), load(inverse, row3 + around.near3 - 5, 8), 4),
            load(inverse, c + 1, 8),
        ),
    )
    at = (which(around.above, around.second, around.below) * (LEFT + 1) + n_left) * 32
    known = load(slots.there, at, 32) > _ZERO
    off = choose(known, (beside - w0) * per_w, spread(_GAP, 32))
    above = join(load(rings.intensity, top, 8), spread(NONE, 8))
    value = choose(known, join(join(left, load(rings.intensity, upper, 8)), above), spread(NONE, 32))
    q = off * _HALF
    weight = load(slots.places, at, 32) / (q * q + _ONE)
    sums = totals(weight, weight * value)
    total = lane(sums, 0) + _LITTLE
    mean = (lane(sums, 1) + _LITTLE * NONE) / total
    apart = lane(totals(weight * size_of(value - mean)), 0) / total
    store(x, to + _RANGES, rounded(squash(off)))
    store(x, to + _GAPS, _gaps(c, n, around, rings))
    store(x, to + _VALUES, rounded(value * _PER_STEP))
    rest = of(
        mean * _PER_STEP, apart * _PER_STEP * _TWO, activity * _PER_STEP * _TWO, np.sqrt(_ONE / w0) * _HALF,
        np.sqrt(w0) * _FOUR, total * _QUARTER, np.float32(n_left) * _EIGHTH, _ZERO,
    )  # fmt: skip
    store(x, to + _REST, rounded(rest))
    nearest = lane(value, 11)
    frame = load(rings.above, row + around.near, 2)
    a = rings.azimuth[np.uint64(around.ring), np.uint64(PAD + around.i)]
    if around.above and lane(frame, 1) - a < a - lane(frame, 0):
        nearest = lane(value, 12)
    return int(lane(value, 7)), int(nearest), mean
