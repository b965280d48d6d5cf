"""Sine and cosine of float32 angles as drivers have them: rounded right, or off by a bit here and there as the C library's.

Drivers ask ``sinf`` and ``cosf``. What most C libraries answer today is a polynomial in float64, rounded once; it is not always the
nearest float32, and a point shows the difference. Decoders ask no library: both kinds are computed here by ``+ - *`` on float64.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from salpcc.stages.lattice.trig import HALF_PI, sin_cos

ROUNDED, POLYNOMIAL = 0, 1  # kinds

_QUARTER = 0.7853981852531433  # the float32 next to pi / 4; angles below are not reduced
_QUARTERS = 10680707.430881744  # 2^24 quarter turns in a radian, as the library divides
_HALF = 1 << 23
# The library's polynomials of sine and cosine in -pi / 4 ... pi / 4.
_S1, _S2, _S3 = -0.16666654943701084, 0.008332178146138854, -0.00019517298981385725
_C1, _C2, _C3, _C4 = -0.49999999725108224, 0.041666623324344516, -0.001388676379437604, 2.4390450703564542e-05


@njit(cache=True, error_model="numpy")
def sine32(kind: int, angle: np.float32) -> np.float32:
    """Return the float32 sine of a float32 angle of some turns at most."""
    if kind == ROUNDED:
        return np.float32(sin_cos(np.float64(angle))[0])
    x, quarter = _reduced(angle)
    value = _even(x) if quarter & 1 else _odd(x)
    return np.float32(-value if quarter & 2 else value)


@njit(cache=True, error_model="numpy")
def cosine32(kind: int, angle: np.float32) -> np.float32:
    """Return the float32 cosine of a float32 angle of some turns at most."""
    if kind == ROUNDED:
        return np.float32(sin_cos(np.float64(angle))[1])
    x, quarter = _reduced(angle)
    value = _odd(x) if quarter & 1 else _even(x)
    return np.float32(-value if (quarter + 1) & 2 else value)


@njit(cache=True, error_model="numpy")
def _reduced(angle: float) -> tuple[np.float64, np.int64 | int]:
    """The angle less so many quarter turns, and their number modulo 4."""
    x = np.float64(angle)
    if abs(x) < _QUARTER:
        return x, 0
    quarter = (np.int64(x * _QUARTERS) + _HALF) >> 24
    return x - quarter * HALF_PI, quarter & 3


@njit(cache=True, error_model="numpy")
def _odd(x: float) -> float:
    square = x * x
    cube = x * square
    return (x + cube * _S1) + cube * square * (_S2 + square * _S3)


@njit(cache=True, error_model="numpy")
def _even(x: float) -> float:
    square = x * x
    fourth = square * square
    return ((1.0 + square * _C1) + fourth * _C2) + fourth * square * (_C3 + square * _C4)
