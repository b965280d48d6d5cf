"""Points on whole angles, told one after the other: the laser, by which came after the one before; azimuth and elevation, as far as they are not those
that the laser had when it fired last; the count, in 1/r from the laser's last points and those of its neighbours in elevation.

The azimuths of all lasers go on together: a clock, in steps of azimuth, that most often goes on by one of the last steps, and each laser's offset against it.
Sensors correct angles by tables, so that a laser's elevation and offset are others after a while.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.entropy.range_coder import new_bits
from salpcc.stages.entropy.residual_bits import CLASSES, PER_CONTEXT, code_number, size_of
from salpcc.stages.entropy.walks import code_mixed_bit, code_raw
from salpcc.stages.lists.aimed.aimed_neighbours import (
    GUESSES,
    SURFACE,
    above_and_below,
    guess_inverse,
    learn_distance,
    link,
)
from salpcc.stages.lists.rays.ray_forms import SPREADS, bucket_of

_STEPS = 8  # of the clock that are remembered
_CANDIDATES = 3  # for the next laser
_CORRECTED = 1500  # steps of azimuth; what is farther off than a correction
_LARGEST = (1 << 39) - 1
_NEXT, _GOES, _STEP = 0, 64, 80  # where contexts begin
_NEAREST, _FARTHEST = 1e-3, 1e4  # metres


def new_models() -> tuple[NDArray[np.uint16], ...]:
    """Return fresh contexts: of bits, of angles, of the count (two)."""
    return (
        new_bits(_STEP + _STEPS * (_STEPS + 1)),
        new_bits(4 * PER_CONTEXT),
        new_bits(SPREADS * PER_CONTEXT),
        new_bits(CLASSES * CLASSES * PER_CONTEXT),
    )


@njit(cache=True, error_model="numpy")
def code_angled(  # type: ignore[no-untyped-def]
    writing, laser, azimuth, elevation, count, beside_of, base, unit, turn, models, state, data
):
    """Write or read lasers ``(N,)`` uint8, azimuths, elevations and counts ``(N,)`` int64.

    Args:
        beside_of: the lasers above and below each, -1: none.
        base: elevation of each laser at first.
        unit: metres of a count. ``turn``: steps of azimuth in a turn.
    """
    bits, of_angles, of_spread, of_sizes = models
    above, below = beside_of
    n, lasers = len(laser), len(base)
    after, missed = np.zeros((lasers, 2), np.int64), np.zeros(lasers, np.int64)
    went, fired = np.zeros((lasers, lasers), np.uint8), np.full(lasers, -1)
    offset, level = np.zeros(lasers, np.int64), base.copy()
    steps, used, last = np.zeros(_STEPS, np.int64), np.zeros(_STEPS, np.int64), _STEPS
    clock, block, before, told = np.int64(0), 0, np.int64(0), np.int64(0)
    links, ends = np.full((n, 2), -1), np.full((lasers, 2), -1)
    cursor = np.full((lasers, 2), -1)
    inverse, here = np.zeros(n), np.zeros(n)
    surface = np.zeros((n, SURFACE))
    beside, errors = np.zeros((n, 2)), np.zeros((n, GUESSES), np.uint16)
    sizes, guess = np.zeros(n, np.uint8), np.zeros(GUESSES)
    for i in range(n):
        # The laser.
        k = np.int64(laser[i])
        c = 0
        while c < _CANDIDATES:
            likely = after[before, c] if c < 2 else after[after[before, 0], 0]
            spot = _NEXT + 8 * c + missed[before]
            other = np.int64(likely != k)
            if code_mixed_bit(writing, state, data, bits, spot, bits, spot, other) == 0:
                k = likely
                break
            c += 1
        if c == _CANDIDATES:
            k = np.int64(code_raw(writing, state, data, 8, k))
            if k >= lasers:
                state[3] = 1
                return
        missed[before] = (2 * missed[before] + int(c > 0)) & 7
        if after[before, 0] != k:
            after[before, 1] = after[before, 0]
            after[before, 0] = k
        # The azimuth.
        new = ends[k, 1] < 0
        back = fired[k] == block
        spot = _GOES + (8 if new else 2 * np.int64(went[before, k]) + int(back))
        off = azimuth[i] - clock - offset[k]
        goes = np.int64(not new and abs(off) > _CORRECTED)
        goes = code_mixed_bit(writing, state, data, bits, spot, bits, spot, goes)
        went[before, k] = 2 * (went[before, k] & 1) + goes
        if goes != 0:
            c = 0
            while c < _STEPS:
                spot = _STEP + last * _STEPS + c
                far = np.int64(off != steps[c])
                if code_mixed_bit(writing, state, data, bits, spot, bits, spot, far) == 0:
                    break
                c += 1
            if c == _STEPS:
                if writing and abs(off) > _LARGEST:
                    state[3] = 1
                    return
                told += code_number(writing, state, data, of_angles, 0, of_angles, 0, off - told)
                last = c
                c = int(used.argmin())
                steps[c] = told
            else:
                last = c
            used[c] = i
            clock += steps[c]
            block += 1
            off -= steps[c]
        spot = 1 if not new else 2
        rest = code_number(writing, state, data, of_angles, spot, of_angles, spot, off)
        offset[k] += rest
        azimuth[i] = clock + offset[k]
        fired[k] = block
        rest = code_number(writing, state, data, of_angles, 3, of_angles, 3, elevation[i] - level[k])
        level[k] += rest
        elevation[i] = level[k]
        before = k
        # The count.
        here[i] = np.float64(azimuth[i] % turn)
        place = ends[k, 1]
        upper = above_and_below(i, k, above[k], 0, turn, here, surface, links, ends, cursor, beside)
        lower = above_and_below(i, k, below[k], 1, turn, here, surface, links, ends, cursor, beside)
        r, spread, apart = guess_inverse(
            i, place, np.int64(-1), upper, lower, turn, here, inverse, surface, beside, errors, guess
        )
        whole = np.int64(np.rint(r / unit))
        size = np.int64(sizes[place]) if place >= 0 else CLASSES - 1
        near = min(bucket_of(apart, unit) // 2, CLASSES - 1) * CLASSES + size
        number = code_number(
            writing, state, data, of_spread, bucket_of(spread, unit), of_sizes, near, count[i] - whole
        )
        count[i] = whole + number
        sizes[i] = (size_of(abs(number)) + 1) // 2
        if state[3] != 0:
            return
        d = min(max(count[i] * unit, _NEAREST), _FARTHEST)
        learn_distance(i, place, d, 1.0 / r, turn, here, inverse, surface, beside, errors, guess)
        link(i, k, links, ends)
