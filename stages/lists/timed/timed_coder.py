"""Points on the rays of lasers that turn steadily (:mod:`.turning_rays`), told by their lasers and times (:mod:`~salpcc.stages.lists.timeline`).

The distance is guessed in 1/r from the laser's last two points and those of its neighbours in elevation, as for points on a lattice. The coordinate in
which the ray points comes first, then the others, foretold again from it. How the sensor's turning strays from a steady one is learned from the
points as they come. The decoder repeats all of this, hence only ``+ - * /`` and square roots on float64, in a fixed order.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.entropy.range_coder import new_bits
from salpcc.stages.entropy.residual_bits import CLASSES, PER_CONTEXT, code_number, size_of
from salpcc.stages.lattice.trig import TWO_PI, arctan2
from salpcc.stages.lists.aimed.aimed_neighbours import (
    GUESSES,
    SURFACE,
    above_and_below,
    guess_inverse,
    learn_distance,
    link,
)
from salpcc.stages.lists.learned.learned_rays import code_learned_ray, learn_ray
from salpcc.stages.lists.rays.ray_forms import (
    GRID,
    HALVES,
    SPREADS,
    bucket_of,
    coordinate_of,
    whole_of,
)
from salpcc.stages.lists.timed.turning_rays import ray_at

_GAIN = 0.1  # of what a point tells of its sensor's turning
_MOST_TURNED = 2e-3  # radians that one point may say
_WANDERS = 1e-4  # radians that rays are off by
_NEAREST, _FARTHEST = 1e-3, 1e4  # metres


def new_models() -> tuple[NDArray[np.uint16], ...]:
    """Return fresh contexts: of the number along the ray (two), of those across it (two)."""
    return (
        new_bits(SPREADS * PER_CONTEXT),
        new_bits(CLASSES * CLASSES * PER_CONTEXT),
        new_bits(2 * SPREADS * PER_CONTEXT),
        new_bits(2 * CLASSES * CLASSES * PER_CONTEXT),
    )


@njit(cache=True, error_model="numpy")
def _grain(value: float, form: int, per: float) -> float:
    """Distance of the numbers that a coordinate may be."""
    if form == GRID:
        return 1.0 / per
    size = max(abs(value), 1e-6)
    return size * (6e-4 if form == HALVES else 8e-8)


@njit(cache=True, error_model="numpy")
def code_timed(  # type: ignore[no-untyped-def]
    writing, points, given, laser, group, time, rays, beside_of, form, per, models, learned, state, data
):
    """Write or read points ``(N, 3)`` float32.

    Args:
        given: which points ``(N,)`` a reader has, so that they are not coded.
        laser, time: of each point ``(N,)``; times from -1/2 to 1/2. ``group``: the sensor of each laser.
        rays: of :class:`~.turning_rays.Turning`.
        beside_of: the lasers above and below each, -1: none.
        learned: models and what they see (:mod:`~salpcc.stages.lists.learned.learned_rays`), of efforts above ``fast``, or None: then numbers are coded in the two contexts of each.
    """
    lasers, sensors, motion = rays
    above, below = beside_of
    of_spread, of_sizes, of_grain, of_across = models
    n = len(points)
    links, ends = np.full((n, 2), -1), np.full((len(lasers), 2), -1)
    cursor, second_of = np.full((len(lasers), 2), -1), np.full(len(lasers), -1)
    inverse, azimuth = np.zeros(n), np.zeros(n)
    surface = np.zeros((n, SURFACE))
    beside, errors = np.zeros((n, 2)), np.zeros((n, GUESSES), np.uint16)
    sizes = np.zeros((n, 3), np.uint8)
    guess, turned, numbers = np.zeros(GUESSES), np.zeros(len(sensors)), np.zeros(3, np.int64)
    recent = 0
    for i in range(n):
        k = np.int64(laser[i])
        g = group[k]
        strayed = turned[g]
        if learned is not None:
            strayed += learned.models.bias[k]
        o, d, turning = ray_at(lasers, sensors, motion, k, g, time[i], strayed)
        azimuth[i] = arctan2(d[1], d[0])
        place = ends[k, 1]
        upper = above_and_below(i, k, above[k], 0, TWO_PI, azimuth, surface, links, ends, cursor, beside)
        lower = above_and_below(i, k, below[k], 1, TWO_PI, azimuth, surface, links, ends, cursor, beside)
        r, spread, apart = guess_inverse(
            i,
            place,
            second_of[k],
            upper,
            lower,
            TWO_PI,
            azimuth,
            inverse,
            surface,
            beside,
            errors,
            guess,
        )
        expected = 1.0 / r
        axis = 0
        if abs(d[1]) > abs(d[0]):
            axis = 1
        if abs(d[2]) > max(abs(d[0]), abs(d[1])):
            axis = 2
        if learned is not None:
            code_learned_ray(
                given[i], writing, state, data, learned, i, k, g, (place, upper, lower), (r, spread, apart), (o, d, turning), axis, points,
                time, form, per, azimuth, inverse, errors, guess,
            )  # fmt: skip
        else:
            foretold = o[axis] + r * d[axis]
            whole = whole_of(foretold, form, per)
            unit = max(_grain(foretold, form, per) / abs(d[axis]), 1e-9)
            size = np.int64(sizes[place, 0]) if place >= 0 else CLASSES - 1
            known = writing or given[i]
            numbers[0] = whole_of(points[i, axis], form, per) - whole if known else 0
            if not given[i]:
                numbers[0] = code_number(
                    writing, state, data, of_spread, bucket_of(spread, unit),
                    of_sizes, min(bucket_of(apart, unit) // 2, CLASSES - 1) * CLASSES + size, numbers[0],
                )  # fmt: skip
            sizes[i, 0] = (size_of(abs(numbers[0])) + 1) // 2
            if not given[i]:
                points[i, axis] = coordinate_of(whole + numbers[0], form, per)
            r = (np.float64(points[i, axis]) - o[axis]) / d[axis]
            r = min(max(r, _NEAREST), _FARTHEST)
            grain = _grain(np.float64(points[i, axis]), form, per)
            for c in range(1, 3):
                other = axis + c if axis + c < 3 else axis + c - 3
                foretold = o[other] + r * d[other]
                whole = whole_of(foretold, form, per)
                numbers[c] = whole_of(points[i, other], form, per) - whole if known else 0
                near = np.int64(sizes[place, c]) if place >= 0 else CLASSES - 1
                loose = abs(d[other] / d[axis]) * grain * 0.5 + r * _WANDERS * (1.0 if other == 2 else 2.0)
                if not given[i]:
                    numbers[c] = code_number(
                        writing, state, data, of_grain, (c - 1) * SPREADS + bucket_of(loose, _grain(foretold, form, per)),
                        of_across, ((c - 1) * CLASSES + near) * CLASSES + np.int64(sizes[recent, c]), numbers[c],
                    )  # fmt: skip
                sizes[i, c] = (size_of(abs(numbers[c])) + 1) // 2
                if not given[i]:
                    points[i, other] = coordinate_of(whole + numbers[c], form, per)
        if not writing and state[3] != 0:
            return
        x, y, z = (
            np.float64(points[i, 0]) - o[0],
            np.float64(points[i, 1]) - o[1],
            np.float64(points[i, 2]) - o[2],
        )
        r = np.sqrt(x * x + y * y + z * z)
        if not _NEAREST < r < _FARTHEST:
            continue
        aside = (x * turning[0] + y * turning[1] + z * turning[2]) / r
        if learned is None:
            turned[g] += _GAIN * min(max(aside, -_MOST_TURNED), _MOST_TURNED)
        else:
            turned[g] += learn_ray(learned, i, k, g, place, points[i], turning, r, aside, form, per, inverse)
        learn_distance(
            i, place, r, expected, TWO_PI, azimuth, inverse, surface, beside, errors, guess
        )  # fmt: skip
        if place < 0 or time[place] != time[i]:
            link(i, k, links, ends)
        else:
            second_of[k] = i
        recent = i
