"""Points on rays (:mod:`~salpcc.stages.lists.timed.timed_coder`) as efforts above ``fast`` learn them: mixtures of what their neighbours and the sweep before say.

The first coordinate tells the distance to within its grain, which leaves an interval for the second, and the two a shorter one for the third: what that
is depends on how long it is and on where between two whole numbers its middle lies. How far a sensor's turning strays from a steady one is followed as closely as each point's grain allows, and how far
each laser strays from that more slowly.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.entropy.mixed_numbers import (
    Guesses,
    Numbers,
    code_mixed_number,
    learn_trust,
    new_guesses,
    new_numbers,
    weigh,
)
from salpcc.stages.entropy.range_coder import new_bits
from salpcc.stages.entropy.residual_bits import PER_CONTEXT, code_number, size_of
from salpcc.stages.lattice.trig import TWO_PI
from salpcc.stages.lists.aimed.aimed_neighbours import GUESSES, mean_error, nearest_of, weight_of
from salpcc.stages.lists.learned.learned_counts import (
    CONTEXTS,
    FIRST,
    LEAST,
    SIGNED,
    SIZES,
    SPREADS,
    WIDER,
    bucket_by,
    fill_places,
    off_before,
    signed_bucket,
    weigh_before,
    with_change,
)
from salpcc.stages.lists.learned.moved_sweep import Turn
from salpcc.stages.lists.rays.ray_forms import GRID, HALVES, coordinate_of, whole_of
from salpcc.stages.lists.timeline import LASERS

# Contexts of the other coordinates: widths, and where between two whole numbers.
_WIDTHS, _LOOSE, _PARTS, _HALVES = 16, 16, 8, 4
_BEFORE = 2  # guesses by the sweep before
_MOST = GUESSES + _BEFORE
_NEAR = 0.001  # turns; what was farther off says nothing
_UP = 2e-5  # radians that elevations are off
_STRAYS = 3e-5  # radians that a sensor's turning strays from point to point
_AT_FIRST = 1e-3  # radians that it may have strayed before
_OF_LASER = 0.002  # of what a point tells of its laser
_MOST_TURNED = 2e-3  # radians that one point may say

I64 = NDArray[np.int64]
F64 = NDArray[np.float64]


class RayModels(NamedTuple):
    """What outlives a sweep: contexts of the first coordinate, trust in its guesses; contexts of the others (two); how far the azimuth of each laser is off ``(LASERS,)``, radians."""

    reach: Numbers
    trust: F64
    widths: NDArray[np.uint16]
    misses: NDArray[np.uint16]
    bias: F64


class RaySeen(NamedTuple):
    """What a sweep of n points has shown so far, and room to work in.

    Attributes:
        before: the sweep before as it is seen now; ``cursor (LASERS, 1)`` goes along with it.
        was: of each point ``(n, 1)`` 1/d in it, 0 where that says nothing; ``there (n,)`` its place in the list before, -1: none;
            ``off (n, 2)`` how far off the guesses by it were.
        missed, sizes: of each point, how far off the centre it was in spreads, and the size of that in grains; ``beside (n, 2)`` of its other numbers.
        variance: of how far each sensor has strayed ``(LASERS,)``.
    """

    before: Turn
    cursor: I64
    was: F64
    there: I64
    off: NDArray[np.float32]
    missed: NDArray[np.float32]
    sizes: NDArray[np.uint8]
    beside: NDArray[np.float32]
    variance: F64
    guesses: Guesses
    places: I64
    opinions: F64


def new_ray_models() -> RayModels:
    """Return fresh models."""
    return RayModels(
        new_numbers(int(FIRST[-1]), 2 * SPREADS, len(CONTEXTS)),
        np.ones((2, _MOST)),
        new_bits(2 * _WIDTHS * _PARTS * PER_CONTEXT),
        new_bits(2 * _LOOSE * _HALVES * SIGNED * PER_CONTEXT),
        np.zeros(LASERS),
    )


def no_rays(n: int, before: Turn) -> RaySeen:
    """Return what is known before the first of ``n`` points."""
    return RaySeen(
        before, np.full((LASERS, 1), -1), np.zeros((n, 1)), np.full(n, -1), np.zeros((n, _BEFORE), np.float32),
        np.zeros(n, np.float32), np.zeros(n, np.uint8), np.zeros((n, 2), np.float32),
        np.full(LASERS, _AT_FIRST * _AT_FIRST),
        new_guesses(_MOST), np.zeros(len(CONTEXTS), np.int64), np.zeros(len(CONTEXTS)),
    )  # fmt: skip


@njit(cache=True, error_model="numpy", inline="always", _nrt=False)
def _scaled(value: float, form: int, per: float) -> float:
    """A coordinate in the whole numbers of :func:`.whole_of`, between them too."""
    if form == GRID:
        return value * per
    bits = np.int64(np.float32(value).view(np.int32))
    ordered = np.float64(bits ^ 0x7FFFFFFF if bits < 0 else bits)
    return ordered / 8192.0 if form == HALVES else ordered


@njit(cache=True, error_model="numpy", inline="always", _nrt=False)
def grain_at(whole: int, form: int, per: float) -> float:
    """From a coordinate to the next, metres."""
    if form == GRID:
        return 1.0 / per
    grain = abs(np.float64(coordinate_of(whole + 1, form, per)) - np.float64(coordinate_of(whole, form, per)))
    return min(max(grain, 1e-9), 1e4) if grain < 1e9 else 1e4


@njit(cache=True, error_model="numpy", _nrt=False)
def code_reach(  # type: ignore[no-untyped-def]
    given, writing, state, data, models: RayModels, seen: RaySeen, i, k, again, neighbours, told, ray, form, per, azimuth, inverse, errors, guess, wanted,
):  # fmt: skip
    """Write the first coordinate of point i of laser k as a whole number, or read and return it.

    Args:
        given: it is known already, and only taken note of.
        again: of the same firing as the last of its laser.
        neighbours, told, azimuth, inverse, errors, guess: as :func:`.learned_counts.code_count` has them; ``ray``: origin and direction along the axis.
    """
    place, upper, lower = neighbours
    r, spread, apart = told
    o, d = ray
    guesses, places, trust, was, off = seen.guesses, seen.places, models.trust, seen.was, seen.off
    of = np.int64(again)
    together = _scaled(o + r * d, form, per)
    per_metre = abs(d) / grain_at(whole_of(o + r * d, form, per), form, per)
    spread *= per_metre
    apart *= per_metre
    n, total = 0, 0.0
    for p in range(GUESSES):
        wide = mean_error(errors, p, place, upper, lower)
        far = 1.0 / guess[p]
        guesses.mean[n] = _scaled(o + far * d, form, per)
        guesses.per[n] = 1.0 / (wide * far * per_metre * WIDER + LEAST)
        guesses.weight[n] = weight_of(guess, p, wide)
        total += guesses.weight[n]
        n += 1
    for j in range(n):
        guesses.weight[j] *= trust[of, j] / total
    was[i, 0] = 0.0
    if len(seen.before.azimuth) > 0 and seen.before.ends[k, 1] >= 0:
        _, _, links, ends, there = seen.before
        at, away = nearest_of(azimuth[i], k, seen.cursor, k, 0, TWO_PI, seen.before.azimuth, links, ends)
        if abs(away) < _NEAR * TWO_PI:
            was[i, 0], seen.there[i] = seen.before.inverse[at], there[at]
            near, far = off_before(was, off, 0, place, upper, lower)
            for which in range(_BEFORE):
                if which == 1 and (place < 0 or was[place, 0] == 0.0):
                    break
                value = was[i, 0] if which == 0 else with_change(was, 0, i, place, inverse)
                wide = (near if which == 0 else far) / was[i, 0] * per_metre
                guesses.mean[n] = _scaled(o + d / value, form, per)
                weigh_before(guesses, n, wide, which, spread, trust[of, n])
                n += 1
    centre = weigh(guesses, n, together)
    side = 1.0 if d >= 0.0 else -1.0
    grain = side / (spread + 0.5)
    size = np.int64(seen.sizes[place]) if place >= 0 else SIZES - 1
    wide_bucket = bucket_by(spread, 0.5, 1.6, SPREADS)
    of_before = 4
    if was[i, 0] > 0.0:
        of_before = signed_bucket((_scaled(o + d / was[i, 0], form, per) - centre) * grain)
    of_place = signed_bucket((guesses.mean[0] - centre) * grain)
    missed = signed_bucket(seen.missed[place]) if place >= 0 else 4
    missed_above = signed_bucket(seen.missed[upper]) if upper >= 0 else 4
    fill_places(places, k, apart, size, wide_bucket, of_place, of_before, missed, missed_above)
    found = wanted
    if not given:
        found = code_mixed_number(
            writing, state, data, wanted, centre, guesses, n, models.reach, places, of * SPREADS + wide_bucket, seen.opinions
        )  # fmt: skip
    learn_trust(found, guesses, n, trust, of)
    seen.missed[i] = min(max((found - centre) * grain, -100.0), 100.0)
    seen.sizes[i] = min(size_of(abs(found - np.int64(np.floor(centre + 0.5)))), SIZES - 1)
    return found


@njit(cache=True, error_model="numpy", inline="always", _nrt=False)
def learn_reach(seen: RaySeen, i: int, place: int, inverse: F64, r: float) -> None:
    """Take note that point i is at the distance ``r``."""
    was = seen.was
    if was[i, 0] > 0.0:
        seen.off[i, 0] = min(abs(was[i, 0] * r - 1.0), 1.0)
        seen.off[i, 1] = min(abs(with_change(was, 0, i, place, inverse) * r - 1.0), 1.0)


@njit(cache=True, error_model="numpy", inline="always", _nrt=False)
def code_aside(  # type: ignore[no-untyped-def]
    given, writing, state, data, models: RayModels, seen: RaySeen, i, place, c, foretold, wide, loose, form, per, wanted
):  # fmt: skip
    """Write coordinate c (1, 2) after the first one as a whole number, or read and return it.

    Args:
        foretold: in the middle of an interval ``wide`` metres long; ``loose``: that it may be off by besides.
    """
    middle = _scaled(foretold, form, per)
    whole = np.int64(np.floor(middle + 0.5))
    per_metre = 1.0 / grain_at(whole, form, per)
    wide *= per_metre
    loose *= per_metre
    part = min(max(int((middle - whole + 0.5) * _PARTS), 0), _PARTS - 1)
    own = signed_bucket(seen.beside[place, c - 1]) if place >= 0 else 4
    of_wide = (c - 1) * _WIDTHS + bucket_by(wide, 0.1, 1.4142135623730951, _WIDTHS)
    of_loose = (c - 1) * _LOOSE + bucket_by(loose, 0.05, 2.0, _LOOSE)
    off = wanted - whole
    if not given:
        off = code_number(
            writing, state, data, models.widths, of_wide * _PARTS + part,
            models.misses, (of_loose * _HALVES + part * _HALVES // _PARTS) * SIGNED + own, off,
        )  # fmt: skip
    seen.beside[i, c - 1] = min(max((whole + off - middle) / (wide * 0.5 + loose + 0.25), -100.0), 100.0)
    return whole + off


@njit(cache=True, error_model="numpy", _nrt=False)
def code_learned_ray(  # type: ignore[no-untyped-def]
    given, writing, state, data, learned, i, k, g, neighbours, told, ray, axis, points, time, form, per, azimuth, inverse, errors, guess
):  # fmt: skip
    """Write the coordinates ``points[i]``, or read them into it.

    Args:
        given: they are known already, and only taken note of.
        g: the sensor of laser k; ``ray``: origin, direction, and the direction in which it turns.
    """
    models, seen = learned
    o, d, turning = ray
    place = neighbours[0]
    again = place >= 0 and time[place] == time[i]
    whole = code_reach(
        given, writing, state, data, models, seen, i, k, again, neighbours, told, (o[axis], d[axis]), form, per, azimuth, inverse, errors,
        guess, whole_of(points[i, axis], form, per),
    )  # fmt: skip
    if not given:
        points[i, axis] = coordinate_of(whole, form, per)
    r = (np.float64(points[i, axis]) - o[axis]) / d[axis]
    half = 0.5 * grain_at(whole, form, per) / abs(d[axis])
    strays = np.sqrt(seen.variance[g])
    for c in range(1, 3):
        if not r > 1e-3:  # of what is no number, too
            r = 1e-3
        r = min(r, 1e4)
        half = min(half, r)
        other = axis + c if axis + c < 3 else axis + c - 3
        foretold = o[other] + r * d[other]
        loose = r * (strays * abs(turning[other]) + _UP)
        whole = code_aside(
            given, writing, state, data, models, seen, i, place, c, foretold, 2.0 * half * abs(d[other]), loose, form, per,
            whole_of(points[i, other], form, per),
        )  # fmt: skip
        if not given:
            points[i, other] = coordinate_of(whole, form, per)
        if c == 1 and abs(d[other]) > 1e-6:
            # Both intervals of the distance hold; each may be off a little.
            at = (np.float64(points[i, other]) - o[other]) / d[other]
            reach = (0.5 * grain_at(whole, form, per) + loose) / abs(d[other])
            low, high = max(r - half, at - reach), min(r + half, at + reach)
            if low < high:
                r, half = 0.5 * (low + high), 0.5 * (high - low)


@njit(cache=True, error_model="numpy", _nrt=False)
def learn_ray(learned, i, k, g, place, point, turning, r, aside, form, per, inverse):  # type: ignore[no-untyped-def]
    """Take note of where the point i of laser k is, ``r`` along its ray and ``aside`` of it, radians; return by how much its sensor has strayed."""
    models, seen = learned
    learn_reach(seen, i, place, inverse, r)
    noise = _UP * _UP
    for c in range(3):
        grain = grain_at(whole_of(point[c], form, per), form, per) * turning[c] / r
        noise += grain * grain * (1.0 / 12.0)
    variance = seen.variance[g] + _STRAYS * _STRAYS
    gain = variance / (variance + noise)
    aside = min(max(aside, -_MOST_TURNED), _MOST_TURNED)
    if aside * aside > 25.0 * (variance + noise):
        gain *= 0.3
    seen.variance[g] = variance * (1.0 - gain)
    models.bias[k] += _OF_LASER * aside
    return gain * aside
