"""What :mod:`.ray_coder` makes numbers of: rays, coordinates as whole numbers, buckets of spreads."""

from __future__ import annotations

import numpy as np
from numba import njit

from salpcc.stages.entropy.half_octaves import half_octaves

ALONG, GRID, BITS, HALVES = 0, 1, 2, 4  # 3 is another's
_HALF_BITS = 13  # that float16 values have less than float32
SPREADS = 64
FAR = 1e6  # metres


@njit(cache=True, error_model="numpy")
def bucket_of(value: float, unit: float) -> int:
    """Half-octave bucket of a spread, from 1/8 unit up."""
    return half_octaves(value, unit * 0.125, SPREADS - 1)


@njit(cache=True, error_model="numpy")
def whole_of(value: float, form: int, per: float) -> int:
    """Coordinate as a whole number: of units, or the ordered bits of its float32 or float16."""
    if form == GRID:
        return int(np.rint(min(max(value, -FAR), FAR) * per))
    bits = np.int64(np.float32(value).view(np.int32))
    whole = bits ^ 0x7FFFFFFF if bits < 0 else bits
    return int((whole + (1 << (_HALF_BITS - 1))) >> _HALF_BITS if form == HALVES else whole)


@njit(cache=True, error_model="numpy")
def coordinate_of(whole: int, form: int, per: float) -> np.float32:
    """Inverse of :func:`whole_of`."""
    if form == GRID:
        return np.float32(whole / per)
    if form == HALVES:
        whole = (whole << _HALF_BITS) - int(whole < 0)
    bits = min(max(whole, -(1 << 31)), (1 << 31) - 1)
    return np.int32(bits ^ 0x7FFFFFFF if bits < 0 else bits).view(np.float32)


@njit(cache=True, error_model="numpy")
def ray_of(points, place, before, upper, upper_left):  # type: ignore[no-untyped-def]
    """Unit vector guessed for the next point: ``place`` turned as ``before`` or the upper points say; -1: none."""
    x, y, z = np.float64(points[place, 0]), np.float64(points[place, 1]), np.float64(points[place, 2])
    a, b = (upper, upper_left) if upper >= 0 and upper_left >= 0 else (place, before)
    if a >= 0 and b >= 0:
        ax, ay = np.float64(points[a, 0]), np.float64(points[a, 1])
        bx, by = np.float64(points[b, 0]), np.float64(points[b, 1])
        c, s = ax * bx + ay * by, ay * bx - ax * by
        length = np.sqrt(c * c + s * s)
        if length > 1e-9 and c > 0.0:
            x, y = (x * c - y * s) / length, (x * s + y * c) / length
    r = np.sqrt(x * x + y * y + z * z)
    return x / r, y / r, z / r
