"""Features of one return's intensity: neighbours' intensities and the whole sweep's ranges.

Ranges are coded first, so ranges of the returns to the right and below are known too. Same exact
arithmetic and layout as :mod:`salpcc.stages.predict.learned.range_features`.

Slots are lanes 2 to 19 of a vector of 32: six returns to the left on the current ring, eight of the ring above, four
of the one above that. Lanes 20 to 23 are returns of the ring below, 24 to 26 those to the right: only ranges.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from salpcc.stages.predict.learned.range_features import rounded, squash
from salpcc.stages.predict.ring_rows import PAD
from salpcc.stages.predict.vectors import (
    choose,
    inline,
    join,
    lane,
    load,
    of,
    size,
    splice,
    spread,
    store,
    summed,
)

LEFT = 6
INPUTS = 56
GAPS = 8  # features that do not depend on intensities
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


class RingBeside(NamedTuple):
    """A ring above or below as the returns of the current one see it; meaningless where ``there`` is not.

    Attributes:
        frame, inverse, intensity: ``(size,)`` azimuths in ticks in the frame of the current laser, inverse ranges, 0..100.
        near: ``(size,)`` by return of the current ring, its return before that.
        there: whether it has returns.
    """

    frame: F32
    inverse: F32
    intensity: F32
    near: I32
    there: bool


class Slots(NamedTuple):
    """What :func:`slot_places` and :func:`ring_gaps` make of a ring: twice ``(LEFT + 1, 32)``, and ``(size, GAPS)``."""

    places: F32
    there: F32
    gaps: I16


@inline
def slot_places(has1: bool, has2: bool, below: bool, places: F32, there: F32) -> None:
    """Fill ``(LEFT + 1, 32)`` weights of the slots by how many returns there are to the left, before nearness.

    ``there`` of the same shape: 1 where a range is known.
    """
    for n in range(LEFT + 1):
        for k in range(32):
            weight, known = _ZERO, True
            if k < 8:
                known = k >= 8 - n
                weight = _ONE
            elif k < 16:
                known = has1
                weight = _ONE if k == 11 or k == 12 else _HALF
            elif k < 20:
                known = has2
                weight = _HALF
            elif k < 24:
                known = below
            places[n, k] = weight if known else _ZERO
            there[n, k] = _ONE if known else _ZERO


@inline
def ring_gaps(m: int, azimuth: F32, above: RingBeside, second: bool, gaps: I16) -> None:
    """Fill the features of all ``m`` returns of a ring that depend on azimuths only, ``gaps`` (m, GAPS)."""
    for i in range(m):
        c = PAD + i
        a = azimuth[c]
        before = (a - azimuth[c - 1]) * _HALF - _ONE if i > 0 else _GAP
        after = (azimuth[c + 1] - a) * _HALF - _ONE if i + 1 < m else _GAP
        j1 = above.near[i]
        left = (a - above.frame[j1]) * _HALF if above.there else _GAP
        right = (above.frame[j1 + 1] - a) * _HALF if above.there else _GAP
        x = squash(of(before, after, left, right, _ZERO, _ZERO, _ZERO, _ZERO))
        there = of(_ONE if above.there else _ZERO, _ONE if second else _ZERO)
        store(gaps, i * GAPS, rounded(splice(x, join(join(there, there), join(there, there)), 4)))


@inline
def intensity_features(  # type: ignore[no-untyped-def]
    i, azimuth, inverse, left, first, second, below, quotient, activity, slots, x
):
    """Fill the inputs ``x`` (END,); return the two nearest intensities (left, above) and the local mean.

    ``left`` are eight lanes of intensities to the left, the nearest last; ``first``, ``second`` and ``below`` are
    :class:`RingBeside`, of the one below only ranges; ``slots`` :class:`Slots`.
    """
    c = PAD + i
    w0 = inverse[c]
    per_w = quotient / (w0 * w0) * _UNIT
    n_left = min(i, LEFT)
    j1, j2 = first.near[i], second.near[i]
    upper, top = j1 - 3, j2 - 1
    around = join(
        join(load(inverse, c - 8, 8), load(first.inverse, upper, 8)),
        join(
            splice(load(second.inverse, top, 8), load(below.inverse, below.near[i] - 5, 8), 4),
            load(inverse, c + 1, 8),
        ),
    )
    known = load(slots.there, n_left * 32, 32) > _ZERO
    off = choose(known, (around - w0) * per_w, spread(_GAP, 32))
    above = join(load(second.intensity, top, 8), spread(NONE, 8))
    value = choose(known, join(join(left, load(first.intensity, upper, 8)), above), spread(NONE, 32))
    q = off * _HALF
    weight = load(slots.places, n_left * 32, 32) / (q * q + _ONE)
    total = summed(_LITTLE, weight, 2, 20)
    mean = summed(_LITTLE * NONE, weight * value, 2, 20) / total
    apart = summed(_ZERO, weight * size(value - mean), 2, 20) / total
    store(x, _RANGES, rounded(squash(off)))
    store(x, _GAPS, load(slots.gaps, i * GAPS, GAPS))
    store(x, _VALUES, rounded(value * _PER_STEP))
    rest = of(
        mean * _PER_STEP, apart * _PER_STEP * _TWO, activity * _PER_STEP * _TWO, np.sqrt(_ONE / w0) * _HALF,
        np.sqrt(w0) * _FOUR, total * _QUARTER, np.float32(n_left) * _EIGHTH, _ZERO,
    )  # fmt: skip
    store(x, _REST, rounded(rest))
    nearest = lane(value, 11)
    if first.there and first.frame[j1 + 1] - azimuth[c] < azimuth[c] - first.frame[j1]:
        nearest = lane(value, 12)
    return int(lane(value, 7)), int(nearest), mean
