"""What :mod:`.aimed_coder` foretells a distance from: points of the same laser and of those next to it in elevation.

Most bits are spent on the noise of ranges, so a guess is a running mean where that is possible: of the line along a laser's surface, of the
surface without its noise, and of how far the surfaces above and below are off. A mean that is far off starts anew: a surface ended there.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

# Guesses of 1/d: that of the laser's last point; the line along its surface; the surfaces above and below, as far off as they lately were; its last second return.
SAME, TREND, ABOVE, BELOW, SECOND = range(5)
GUESSES = 5
# What is known of the surface at a point: 1/d without its noise; 1/d and slope of the running line; how far the surfaces above and below are off, and whether that is known.
CLEAN, LEVEL, SLOPE, OFFSET, FOLLOWED = 0, 1, 2, 3, 5
SURFACE = 7

_STEPS = 64  # that a cursor goes at a time; hostile azimuths must not send it round and round
_NEAR = 0.02  # turns; points farther apart in azimuth are not interpolated between
_EDGE = 16.0  # nor are those of which one is an eighth farther away
_FAR_GAP = 0.003  # turns; a laser's points farther apart are not of one surface
_NO_GAP = 1e-9  # turns; points nearer to each other tell nothing of a slope
_SURFACE = 0.09  # metres; a point so far off does not belong to the running means
_TORN = 9.0  # square of how far off, in these, a surface has ended
_LEAST_TURN, _MOST_TURN = 0.6, 1.7  # of the last 1/d, what a guess may be
_ONE, _HALF, _THIRD = 1.0 / 65535.0, 1.0 / 131070.0, 1.0 / 196605.0  # of errors of as many points
_OFFSET_RATE, _LEVEL_RATE, _SLOPE_RATE, _DENOISE = 0.12, 0.4, 0.2, 0.55


# What a walk asks at every point is put into it: a call lays seven to nine words of each array on the stack.
@njit(cache=True, error_model="numpy", forceinline=True, _nrt=False)
def link(i: int, k: int, links: NDArray[np.int64], ends: NDArray[np.int64]) -> None:
    """Append point i to those of laser k, a ring that closes on itself."""
    if ends[k, 1] < 0:
        ends[k, 0] = i
        links[i, 0] = links[i, 1] = i
    else:
        first, last = ends[k, 0], ends[k, 1]
        links[i, 0], links[i, 1] = last, first
        links[last, 1] = links[first, 0] = i
    ends[k, 1] = i


@njit(cache=True, error_model="numpy", _nrt=False)
def around(here: float, last: int, ticks: int, azimuth: NDArray[np.float64], links: NDArray[np.int64]):  # type: ignore[no-untyped-def]
    """Of the points of a laser, whose rings are in the order of azimuths, find the one nearest to ``here``, and the way (0, 1) from it on which a new one there goes."""
    at, off = nearest_from(here, last, ticks, azimuth, links)
    for way in (1, 0):
        beyond = _apart(here, azimuth[links[at, way]], ticks)
        if off * beyond < 0.0 and abs(beyond) < _NEAR * ticks:
            return at, way
    after = abs(_apart(azimuth[at], azimuth[links[at, 1]], ticks))
    before = abs(_apart(azimuth[at], azimuth[links[at, 0]], ticks))
    return at, np.int64(after >= before)


@njit(cache=True, error_model="numpy", _nrt=False)
def link_beside(i: int, k: int, at: int, way: int, links: NDArray[np.int64], ends: NDArray[np.int64]) -> None:
    """Put point i among those of laser k next to the one ``at``, on the ``way`` of :func:`around`."""
    beyond = links[at, way]
    links[i, 1 - way], links[i, way] = at, beyond
    links[at, way] = i
    links[beyond, 1 - way] = i
    ends[k, 1] = i


@njit(cache=True, error_model="numpy", inline="always", _nrt=False)
def short_way(ticks: int, turn: int) -> int:
    """Whole ticks, of so many in a turn, the short way round."""
    half = turn // 2
    if half - turn < ticks <= half:  # as nearly always: a division takes longer than all the rest
        return ticks
    ticks %= turn
    return ticks - turn if ticks > half else ticks


@njit(cache=True, error_model="numpy", inline="always", _nrt=False)
def _apart(a: float, b: float, ticks: int) -> float:
    """Azimuth from b to a in ticks, the short way round."""
    off = a - b
    half = 0.5 * ticks
    if off > half:
        off -= ticks
    elif off < -half:
        off += ticks
    return off


@njit(cache=True, error_model="numpy", inline="always", _nrt=False)
def nearest_from(here, at, ticks, azimuth, links):  # type: ignore[no-untyped-def]
    """Go along a ring from the point ``at`` both ways while that is nearer to azimuth ``here``; return the point, and how far off it is."""
    off = _apart(here, azimuth[at], ticks)
    for way in (1, 0):
        for _ in range(_STEPS):
            step = links[at, way]
            nearer = _apart(here, azimuth[step], ticks)
            if not abs(nearer) < abs(off):
                break
            at, off = step, nearer
    return at, off


@njit(cache=True, error_model="numpy", inline="always", _nrt=False)
def mean_error(errors, p, place, upper, lower):  # type: ignore[no-untyped-def]
    """How far off the guess p lately was at the points around (-1: none), as a share of the distance."""
    error, seen = np.int64(0), 0
    for j in (place, upper, lower):
        if j >= 0:
            error += np.int64(errors[j, p])
            seen += 1
    share = _ONE if seen == 1 else (_HALF if seen == 2 else _THIRD)
    return error * share + 5e-5 if seen > 0 else 0.5


@njit(cache=True, error_model="numpy", inline="always", _nrt=False)
def nearest_of(here, other, cursor, k, side, ticks, azimuth, links, ends):  # type: ignore[no-untyped-def]
    """Find the point of laser ``other``, which has some, nearest to azimuth ``here``, from where ``cursor[k, side]`` was; and how far off it is."""
    at = cursor[k, side]
    if at < 0:
        first, last = ends[other, 0], ends[other, 1]
        near = abs(_apart(here, azimuth[first], ticks)) < abs(_apart(here, azimuth[last], ticks))
        at = first if near else last
    at, off = nearest_from(here, at, ticks, azimuth, links)
    cursor[k, side] = at
    return at, off


@njit(cache=True, error_model="numpy", forceinline=True, _nrt=False)
def above_and_below(i, k, other, side, ticks, azimuth, surface, links, ends, cursor, beside):  # type: ignore[no-untyped-def]
    """Find the point of laser ``other`` (-1: none) nearest in azimuth to point i of laser k; -1 where it has none yet.

    ``beside[i, side]`` becomes the 1/d of the surface there, interpolated to the azimuth of i where points of one surface lie on both sides; 0 without.
    """
    beside[i, side] = 0.0
    if other < 0 or ends[other, 1] < 0:
        return -1
    at, off = nearest_of(azimuth[i], other, cursor, k, side, ticks, azimuth, links, ends)
    value = surface[at, CLEAN]
    for way in (1, 0):
        beyond = _apart(azimuth[i], azimuth[links[at, way]], ticks)
        if off * beyond < 0.0 and abs(beyond) < _NEAR * ticks:
            there = surface[links[at, way], CLEAN]
            if abs(there - value) * _EDGE < there + value:
                value += (there - value) * (off / (off - beyond))
            break
    beside[i, side] = value
    return at


@njit(cache=True, error_model="numpy", forceinline=True, _nrt=False)
def guess_inverse(  # type: ignore[no-untyped-def]
    i, place, second, upper, lower, ticks, azimuth, inverse, surface, beside, errors, guess
):  # fmt: skip
    """Fill the guesses of 1/d of point i; return the distance they make together, how far it may be off, and how far apart they are.

    Args:
        place: the last point of the same laser, or the nearest.
        second: the last second return of the laser.
        upper, lower: the nearest of the laser's neighbours.  -1: none, of all four.
    """
    near = 0.1
    if place >= 0:
        near = inverse[place]
    elif upper >= 0:
        near = beside[i, 0]
    elif lower >= 0:
        near = beside[i, 1]
    guess[:] = near
    if place >= 0:
        least, most = _LEAST_TURN * near, _MOST_TURN * near
        goes = _apart(azimuth[i], azimuth[place], ticks)
        guess[TREND] = min(max(surface[place, LEVEL] + surface[place, SLOPE] * goes, least), most)
        for side in range(2):
            if beside[i, side] > 0.0 and surface[place, FOLLOWED + side] > 0.0:
                there = beside[i, side] + surface[place, OFFSET + side]
                guess[ABOVE + side] = min(max(there, least), most)
    if second >= 0 and abs(_apart(azimuth[i], azimuth[second], ticks)) < _FAR_GAP * ticks:
        guess[SECOND] = inverse[second]
    # A guess counts one over the fourth power of its error, here times all these powers: divisions take longer than all the rest.
    e0, e1 = mean_error(errors, 0, place, upper, lower), mean_error(errors, 1, place, upper, lower)
    e2, e3 = mean_error(errors, 2, place, upper, lower), mean_error(errors, 3, place, upper, lower)
    e4 = mean_error(errors, 4, place, upper, lower)
    q0, q1, q2, q3, q4 = _fourth(e0), _fourth(e1), _fourth(e2), _fourth(e3), _fourth(e4)
    p01, p34 = q0 * q1, q3 * q4
    w0, w1, w2 = q1 * q2 * p34, q0 * q2 * p34, p01 * p34
    w3, w4 = p01 * q2 * q4, p01 * q2 * q3
    for p in range(GUESSES):
        guess[p] = min(max(guess[p], 1.0 / 1000.0), 10.0)
    g0, g1, g2, g3, g4 = guess[0], guess[1], guess[2], guess[3], guess[4]
    low, high = min(min(min(g0, g1), min(g2, g3)), g4), max(max(max(g0, g1), max(g2, g3)), g4)
    total = w0 + w1 + w2 + w3 + w4
    mean = w0 * g0 + w1 * g1 + w2 * g2 + w3 * g3 + w4 * g4
    spread = w0 * e0 + w1 * e1 + w2 * e2 + w3 * e3 + w4 * e4
    per = 1.0 / mean
    r = total * per
    return r, spread * per, (high - low) * r * r


@njit(cache=True, error_model="numpy", inline="always", _nrt=False)
def _fourth(value: float) -> float:
    """Fourth power."""
    value *= value
    return value * value


@njit(cache=True, error_model="numpy", inline="always", _nrt=False)
def weight_of(guess: NDArray[np.float64], p: int, error: float) -> float:
    """What guess p counts that may be off by the share ``error``; nothing if it is not known, and so that of the last point."""
    return 1.0 / (error * error) if p == SAME or guess[p] != guess[SAME] else 0.0


@njit(cache=True, error_model="numpy", inline="always", _nrt=False)
def learn_distance(  # type: ignore[no-untyped-def]
    i, place, d, expected, ticks, azimuth, inverse, surface, beside, errors, guess
):  # fmt: skip
    """Take note that point i, after ``place`` of the same laser (-1: none), is at the distance ``d``, where 1/d was ``expected``, and of how far its guesses were off."""
    inverse[i] = 1.0 / d
    for p in range(len(guess)):
        error = min(abs(guess[p] * d - 1.0), 1.0) * 65535.0
        if place >= 0:
            error = 0.5 * (errors[place, p] + error)
        errors[i, p] = np.uint16(error)
    w = inverse[i]
    per_surface = d * d * (1.0 / _SURFACE)
    off = (w - expected) * per_surface
    surface[i, CLEAN] = w + _DENOISE * max(1.0 - off * off, 0.0) * (expected - w)
    gap = _apart(azimuth[i], azimuth[place], ticks) if place >= 0 else np.float64(ticks)
    joined = abs(gap) < _FAR_GAP * ticks
    for side in range(2):
        offset = surface[place, OFFSET + side] if joined else 0.0
        followed = surface[place, FOLLOWED + side] if joined else 0.0
        if beside[i, side] > 0.0:
            drift = w - beside[i, side] - offset
            off = drift * per_surface
            offset += (min(_OFFSET_RATE + off * off, 1.0) if followed > 0.0 else 1.0) * drift
            followed = 1.0
        surface[i, OFFSET + side], surface[i, FOLLOWED + side] = offset, followed
    surface[i, LEVEL], surface[i, SLOPE] = w, 0.0
    if joined and abs(gap) > _NO_GAP * ticks:
        ahead = surface[place, LEVEL] + surface[place, SLOPE] * gap
        drift = w - ahead
        off = drift * per_surface
        off *= off
        surface[i, LEVEL] = ahead + min(_LEVEL_RATE + off, 1.0) * drift
        if off < _TORN:
            surface[i, SLOPE] = surface[place, SLOPE] + _SLOPE_RATE * drift / gap
