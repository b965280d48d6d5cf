"""What :mod:`.aimed_coder` foretells a distance from: points of the same laser and of those next to it in elevation."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

_STEPS = 64  # that a cursor goes at a time; hostile azimuths must not send it round and round
_NEAR = 0.02  # turns; points farther apart in azimuth are not interpolated between


@njit(cache=True, error_model="numpy", _nrt=False)
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
    """Of the points of a laser, whose rings are in the order of azimuths, find the one nearest to ``here``, and where a new one goes.

    Returns:
        the nearest; its neighbour beyond ``here``, or else the one on this side; the way (0, 1) from the nearest on which a point here goes.
    """
    at, off = _nearest_from(here, last, ticks, azimuth, links)
    for way in (1, 0):
        beyond = _apart(here, azimuth[links[at, way]], ticks)
        if off * beyond < 0.0 and abs(beyond) < _NEAR * ticks:
            return at, links[at, way], way
    gap = np.int64(
        abs(_apart(azimuth[at], azimuth[links[at, 1]], ticks))
        >= abs(_apart(azimuth[at], azimuth[links[at, 0]], ticks))
    )
    return at, links[at, 1 - gap], gap


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
    ticks %= turn
    return ticks - turn if ticks > turn // 2 else ticks


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
def _nearest_from(here, at, ticks, azimuth, links):  # type: ignore[no-untyped-def]
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
    """How far off the guess p was at the points around (-1: none), as a share of the distance."""
    error, seen = 0.0, 0.0
    for j in (place, upper, lower):
        if j >= 0:
            error += errors[j, p] * (1.0 / 65535.0)
            seen += 1.0
    return error / seen + 5e-5 if seen > 0.0 else 0.5


@njit(cache=True, error_model="numpy", inline="always", _nrt=False)
def nearest_of(here, other, cursor, k, side, ticks, azimuth, links, ends):  # type: ignore[no-untyped-def]
    """Find the point of laser ``other``, which has some, nearest to azimuth ``here``, from where ``cursor[k, side]`` was; and how far off it is."""
    at = cursor[k, side]
    if at < 0:
        first, last = ends[other, 0], ends[other, 1]
        near = abs(_apart(here, azimuth[first], ticks)) < abs(_apart(here, azimuth[last], ticks))
        at = first if near else last
    at, off = _nearest_from(here, at, ticks, azimuth, links)
    cursor[k, side] = at
    return at, off


@njit(cache=True, error_model="numpy", _nrt=False)
def above_and_below(i, k, other, side, ticks, azimuth, inverse, links, ends, cursor, beside):  # type: ignore[no-untyped-def]
    """Find the point of laser ``other`` (-1: none) nearest in azimuth to point i of laser k; -1 where it has none yet.

    ``beside[i, side]`` becomes its 1/d, interpolated to the azimuth of i where points lie on both sides; 0 without.
    """
    beside[i, side] = 0.0
    if other < 0 or ends[other, 1] < 0:
        return -1
    at, off = nearest_of(azimuth[i], other, cursor, k, side, ticks, azimuth, links, ends)
    value = inverse[at]
    for way in (1, 0):
        beyond = _apart(azimuth[i], azimuth[links[at, way]], ticks)
        if off * beyond < 0.0 and abs(beyond) < _NEAR * ticks:
            value += (inverse[links[at, way]] - value) * (off / (off - beyond))
            break
    beside[i, side] = value
    return at


@njit(cache=True, error_model="numpy", _nrt=False)
def guess_inverse(  # type: ignore[no-untyped-def]
    i, place, before, least, upper, lower, ticks, azimuth, inverse, beside, errors, guess
):  # fmt: skip
    """Fill the guesses of 1/d of point i; return the distance they make together, how far it may be off, and how far apart they are.

    Args:
        place: the last point of the same laser, or the nearest; ``before``: the one before that, or beyond. From the two it goes straight on, by more than ``least`` of
            the way between them: 0, or -1 where it may be between them.
        upper, lower: the nearest of the laser's neighbours; -1: none.
    """
    if place >= 0:
        near = inverse[place]
    elif upper >= 0:
        near = beside[i, 0]
    elif lower >= 0:
        near = beside[i, 1]
    else:
        near = 0.1
    guess[:] = near
    if place >= 0:
        went = _apart(azimuth[place], azimuth[before], ticks)
        goes = _apart(azimuth[i], azimuth[place], ticks)
        ratio = goes / went if went != 0.0 else 0.0
        if least < ratio < 2.5:
            guess[1] = near + (near - inverse[before]) * ratio
    for side in range(2):
        value = beside[i, side]
        if (upper if side == 0 else lower) < 0:
            continue
        guess[2 + 2 * side] = value
        if place >= 0 and beside[place, side] > 0.0:
            guess[3 + 2 * side] = near + value - beside[place, side]
    if upper >= 0 and lower >= 0:
        guess[6] = 0.5 * (beside[i, 0] + beside[i, 1])
    elif upper >= 0:
        guess[6] = 0.5 * (near + beside[i, 0])
    elif lower >= 0:
        guess[6] = 0.5 * (near + beside[i, 1])
    # The plane through the neighbours, but never beyond them (LOCO-I).
    guess[7] = max(min(guess[0], guess[2]), min(max(guess[0], guess[2]), guess[3]))
    total = mean = spread = 0.0
    low, high = 10.0, 1.0 / 1000.0
    for p in range(len(guess)):
        guess[p] = min(max(guess[p], 1.0 / 1000.0), 10.0)
        low, high = min(low, guess[p]), max(high, guess[p])
        error = mean_error(errors, p, place, upper, lower)
        weight = 1.0 / (error * error)
        weight = weight * weight
        total += weight
        mean += weight * guess[p]
        spread += weight * error
    r = total / mean
    return r, spread / total * r, (high - low) * r * r
