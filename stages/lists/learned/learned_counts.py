"""The count of a point as efforts above ``fast`` learn it: a mixture of what its neighbours and the sweep before say.

The guesses of 1/d are those of :mod:`~salpcc.stages.lists.aimed.aimed_neighbours`; where the sensor stands still, the point of the same laser nearest in azimuth in the sweep before
says most; where it moves, what was there plus what has changed next to it, and, if the motion is known, the same of the sweep before as it is seen now
(:mod:`.moved_sweep`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.entropy.mixed_numbers import (
    NODES,
    Guesses,
    Numbers,
    code_mixed_number,
    first_places,
    learn_trust,
    new_guesses,
    new_numbers,
    weigh,
)
from salpcc.stages.entropy.residual_bits import size_of
from salpcc.stages.entropy.walks import Buffer, State
from salpcc.stages.lists.aimed.aimed_neighbours import (
    GUESSES,
    SAME,
    SECOND,
    mean_error,
    nearest_from,
    nearest_of,
    weight_of,
)
from salpcc.stages.lists.learned.moved_sweep import Turn
from salpcc.stages.lists.timeline import LASERS

SIZES, SPREADS, SIGNED = 16, 12, 9
CONTEXTS = (SPREADS * SIZES, SPREADS * SIGNED * SIGNED, SPREADS * SIGNED * SIGNED, LASERS)
FIRST = first_places(CONTEXTS)
_FIRST, _AGAIN, _LIKE_LAST, _LIKE_SECOND = range(4)  # what a laser's last point was
_SETS = 8  # of weights and trust: that of the point before, and whether this is a second return
_SWEEPS, _BEFORE = 2, 2  # the sweep before as it was, and as it is seen now; guesses by each
_OWN = GUESSES + 2  # other guesses
_MOST = _OWN + _SWEEPS * _BEFORE
_NEAR, _NEAR_MOVED = 0.0005, 0.001  # turns; what was farther off in the sweep before says nothing
WIDER, LEAST, _LEAST_BEFORE = 0.25, 0.5, 0.4  # widths: of how far off a guess was, and at least, in levels
_UNKNOWN = 0.02  # of the distance

I64 = NDArray[np.int64]
F64 = NDArray[np.float64]


class CountModels(NamedTuple):
    """What outlives a sweep: contexts, and the trust in guesses ``(8, guesses)``."""

    numbers: Numbers
    trust: F64


class CountSeen(NamedTuple):
    """What a sweep of n points has shown so far, and room to work in.

    Attributes:
        before, seen: the sweep before as it was, and as it is seen now, if that is known; ``cursor (256, 2)`` goes along with them.
        last (256,): of each laser, whether its last point was a first return, one more at the same tick, or, where both were about, at the distance of the
            laser's last point, or of its last second return: some drivers write every pair of returns twice.
        was: of each point ``(n, 2)`` 1/d in these, 0 where that says nothing; ``there (n,)`` its place in the list before, as it is seen now, -1: none;
            ``off (n, 4)`` how far off the guesses by them lately were.
        missed, sizes: of each point, how far off the centre it was in spreads, and the size of that in levels.
    """

    before: Turn
    seen: Turn
    cursor: I64
    last: I64
    was: F64
    there: I64
    off: NDArray[np.float32]
    missed: NDArray[np.float32]
    sizes: NDArray[np.uint8]
    guesses: Guesses
    places: I64
    opinions: F64


def new_count_models() -> CountModels:
    """Return fresh models."""
    return CountModels(
        new_numbers(int(FIRST[-1]), _SETS * SPREADS, len(CONTEXTS)), np.ones((_SETS, _MOST), np.float64)
    )


def no_counts(n: int, before: Turn, seen: Turn) -> CountSeen:
    """Return what is known before the first of ``n`` points."""
    return CountSeen(
        before,
        seen,
        np.full((LASERS, _SWEEPS), -1),
        np.zeros(LASERS, np.int64),
        np.zeros((n, _SWEEPS)),
        np.full(n, -1),
        np.zeros((n, _SWEEPS * _BEFORE), np.float32),
        np.zeros(n, np.float32),
        np.zeros(n, np.uint8),
        new_guesses(_MOST),
        np.zeros(len(CONTEXTS), np.int64),
        np.zeros(len(CONTEXTS)),
    )


@njit(cache=True, error_model="numpy", inline="always", _nrt=False)
def bucket_by(value: float, limit: float, ratio: float, most: int) -> int:
    """Count limits ``limit``, ``limit * ratio``, … that a value is above, less than ``most``."""
    bucket = 0
    while bucket < most - 1 and value > limit:
        limit *= ratio
        bucket += 1
    return bucket


@njit(cache=True, error_model="numpy", inline="always", _nrt=False)
def signed_bucket(value: float) -> int:
    """0 to 8: sign, and how many of 0.25, 0.75, 1.5, 3 the magnitude is above; 4 for next to nothing."""
    size = abs(value)
    bucket = np.int64(size > 0.25) + np.int64(size > 0.75) + np.int64(size > 1.5) + np.int64(size > 3.0)
    return int(4 + bucket if value >= 0.0 else 4 - bucket)


@njit(cache=True, error_model="numpy", inline="always", _nrt=False)
def with_change(was: F64, w: int, i: int, place: int, inverse: F64) -> float:
    """1/d that a sweep before had, plus what has changed at ``place``, if anything is known there."""
    if place < 0 or was[place, w] == 0.0:
        return was[i, w]
    return min(max(inverse[place] + was[i, w] - was[place, w], 1e-3), 10.0)


@njit(cache=True, error_model="numpy", inline="always", _nrt=False)
def off_before(was, off, w: int, place: int, upper: int, lower: int):  # type: ignore[no-untyped-def]
    """How far off the two guesses by the sweep before ``w`` were at the points around (-1: none)."""
    near = far = count = 0.0
    for j in (place, upper, lower):
        if j >= 0 and was[j, w] > 0.0:
            near += off[j, 2 * w]
            far += off[j, 2 * w + 1]
            count += 1.0
    near = near / count if count > 0.0 else _UNKNOWN
    far = far / count if count > 0.0 else _UNKNOWN
    return near, far


@njit(cache=True, error_model="numpy", inline="always", _nrt=False)
def weigh_before(guesses: Guesses, n: int, wide: float, which: int, spread: float, trust: float) -> None:
    """Fill width and weight of guess n, by the sweep before (``which`` 0), or by what has changed since (1), that may be ``wide`` off."""
    guesses.per[n] = 1.0 / (wide * WIDER + _LEAST_BEFORE)
    guesses.weight[n] = trust * (1.0 if which == 0 else 0.3) * spread / (wide + spread + 0.1)


@njit(cache=True, error_model="numpy", inline="always", _nrt=False)
def fill_places(
    places: I64,
    k: int,
    apart: float,
    size: int,
    wide: int,
    of_place: int,
    of_before: int,
    missed: int,
    above: int,
) -> None:
    """Fill the contexts of a point of laser k: how far guesses are ``apart``, the ``size`` of the miss before, bucket of the spread,
    where the guesses of the last point and of the sweep before are, what was missed there and above."""
    places[0] = bucket_by(apart, 1.0, 1.6, SPREADS) * SIZES + size
    places[1] = FIRST[1] + (wide * SIGNED + of_place) * SIGNED + of_before
    places[2] = FIRST[2] + (missed * SIGNED + above) * SPREADS + wide
    places[3] = FIRST[3] + k
    for c in range(len(places)):
        places[c] *= NODES


@njit(cache=True, error_model="numpy", inline="always", _nrt=False)
def _guess_before(seen: CountSeen, w, i, place, upper, lower, scale, spread, trust, of, inverse, n):  # type: ignore[no-untyped-def]
    """Add guesses by the sweep before, which had something at ``seen.was[i, w]``; return how many there are now."""
    was, off, guesses = seen.was, seen.off, seen.guesses
    d0, unit, middle = scale
    near, far = off_before(was, off, w, place, upper, lower)
    for which in range(_BEFORE):
        if which == 1 and (place < 0 or was[place, w] == 0.0):
            break
        value = was[i, w] if which == 0 else with_change(was, w, i, place, inverse)
        wide = (near if which == 0 else far) / was[i, w] / unit
        guesses.mean[n] = (1.0 / value - d0) / unit - middle
        weigh_before(guesses, n, wide, which, spread, trust[of, n])
        n += 1
    return n


@njit(cache=True, error_model="numpy", inline="always", _nrt=False)
def code_count(  # type: ignore[no-untyped-def]
    given, writing, state: State, data: Buffer, models: CountModels, seen: CountSeen, i, k, neighbours, told, scale, ticks, azimuth, inverse,
    errors, guess, most, level,
):  # fmt: skip
    """Write the level of point i of laser k, or read and return it.

    Args:
        given: the level is known already, and only learned from.
        neighbours: last point of the laser, nearest above and below; -1: none.
        told: distance, spread and range of the guesses together, as :func:`~salpcc.stages.lists.aimed.aimed_neighbours.guess_inverse` returns them.
        scale: range of level 0 less half a level, metres a level, and 0.5 of a level less a count, in levels.
        azimuth, inverse, errors, guess: of the walk; ``most``: the largest level.
    """
    place, upper, lower = neighbours
    r, spread, apart = told
    d0, unit, middle = scale
    guesses, places, trust, was = seen.guesses, seen.places, models.trust, seen.was
    again = np.int64(place >= 0 and azimuth[place] == azimuth[i])
    of = again * (_SETS // 2) + seen.last[k]
    together = (r - d0) / unit - middle
    spread /= unit
    apart /= unit
    n, total = 0, 0.0
    for p in range(GUESSES):
        off = mean_error(errors, p, place, upper, lower)
        d = 1.0 / guess[p]
        guesses.mean[n] = (d - d0) / unit - middle
        guesses.per[n] = 1.0 / (off * d / unit * WIDER + LEAST)
        guesses.weight[n] = weight_of(guess, p, off)
        total += guesses.weight[n]
        n += 1
    for j in range(n):
        guesses.weight[j] *= trust[of, j] / total
    for wide in (0.5, 2.0):
        guesses.mean[n], guesses.per[n], guesses.weight[n] = (
            together,
            1.0 / (spread * wide + LEAST),
            trust[of, n],
        )
        n += 1
    for w in range(_SWEEPS):
        before = seen.before if w == 0 else seen.seen
        was[i, w] = 0.0
        if len(before.azimuth) == 0 or before.ends[k, 1] < 0:
            continue
        at, off = nearest_of(
            azimuth[i], k, seen.cursor, k, w, ticks, before.azimuth, before.links, before.ends
        )
        near = (_NEAR if w == 0 else _NEAR_MOVED) * ticks
        if w == 0 and at == before.ends[k, 1] and not abs(off) < near:
            # A sweep of more than a turn: its end is no neighbour of its beginning, and goes on beyond it.
            first = before.ends[k, 0]
            other, nearer = nearest_from(azimuth[i], first, ticks, before.azimuth, before.links)
            if abs(nearer) < abs(off):
                at, off = other, nearer
                seen.cursor[k, w] = at
        if abs(off) < near:
            while n < _OWN + w * _BEFORE:  # every guess has its place, and a trust of its own
                guesses.mean[n], guesses.per[n], guesses.weight[n] = together, 1.0, 0.0
                n += 1
            was[i, w] = before.inverse[at]
            if w == 1:
                seen.there[i] = before.places[at]
            n = _guess_before(seen, w, i, place, upper, lower, scale, spread, trust, of, inverse, n)
    centre = min(max(weigh(guesses, n, together), 0.0), np.float64(most))
    size = np.int64(seen.sizes[place]) if place >= 0 else SIZES - 1
    wide = bucket_by(spread, 0.5, 1.6, SPREADS)
    grain = 1.0 / (spread + 0.5)
    of_place = signed_bucket((guesses.mean[SAME] - centre) * grain)
    best = was[i, 1] if was[i, 1] > 0.0 else was[i, 0]
    of_before = signed_bucket(((1.0 / best - d0) / unit - middle - centre) * grain) if best > 0.0 else 4
    missed = signed_bucket(seen.missed[place]) if place >= 0 else 4
    missed_above = signed_bucket(seen.missed[upper]) if upper >= 0 else 4
    fill_places(places, k, apart, size, wide, of_place, of_before, missed, missed_above)
    found = level
    if not given:
        found = code_mixed_number(
            writing, state, data, level, centre, guesses, n, models.numbers, places, of * SPREADS + wide, seen.opinions
        )  # fmt: skip
    found = min(max(found, 0), most)
    learn_trust(found, guesses, n, trust, of)
    seen.last[k] = _AGAIN if again else _FIRST
    if guess[SECOND] != guess[SAME]:
        if found == np.int64(np.floor(guesses.mean[SAME] + 0.5)):
            seen.last[k] = _LIKE_LAST
        elif found == np.int64(np.floor(guesses.mean[SECOND] + 0.5)):
            seen.last[k] = _LIKE_SECOND
    seen.missed[i] = (found - centre) * grain
    seen.sizes[i] = min(size_of(abs(found - np.int64(np.floor(centre + 0.5)))), SIZES - 1)
    d = max((found + middle) * unit + d0, 1e-3)
    for w in range(_SWEEPS):
        if was[i, w] == 0.0:
            continue
        lately = place >= 0 and was[place, w] > 0.0
        changed = with_change(was, w, i, place, inverse)
        for which in range(_BEFORE):
            value = was[i, w] if which == 0 else changed
            off = min(abs(value * d - 1.0), 1.0)
            if lately:
                off = 0.5 * (seen.off[place, 2 * w + which] + off)
            seen.off[i, 2 * w + which] = off
    return found
