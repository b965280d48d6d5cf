"""Sine, cosine and arc tangent that are the same on every machine.

The decoder repeats them, so they use only ``+ - * /`` on float64 in a fixed order (docs/sensor_lattice.md
section 4): Taylor polynomials after an exact reduction, never the C library's functions, whose last
bit differs between systems. The error is below 2e-16, relative to a result of order one.
"""

from __future__ import annotations

from fractions import Fraction
from functools import lru_cache

import numpy as np
from numba import njit

_STEPS = 32


def _arctan_table() -> np.ndarray:
    """atan(k / 32) for k in 0..32, correctly rounded through rational arithmetic.

    atan(a) - atan(b) = atan((a - b) / (1 + a b)) walks from one entry to the next; each small angle
    is its alternating series in exact fractions.
    """
    table = [Fraction(0)]
    for k in range(_STEPS):
        a, b = Fraction(k + 1, _STEPS), Fraction(k, _STEPS)
        u = (a - b) / (1 + a * b)
        series = sum((Fraction((-1) ** n, 2 * n + 1) * u ** (2 * n + 1) for n in range(8)), Fraction(0))
        table.append(table[-1] + series)
    return np.array([float(value) for value in table])


_ARCTAN = _arctan_table()
PI = 3.141592653589793  # nearest float64
HALF_PI = 1.5707963267948966
TWO_PI = 6.283185307179586


@njit(cache=True, error_model="numpy", inline="always")
def arctan2(y: float, x: float) -> float:
    """Return the angle of (x, y) in [-pi, pi]; 0 for the origin and for what is not finite.

    Without branches, so that a loop over points becomes vector instructions.
    """
    ax = abs(x)
    ay = abs(y)
    swap = ay > ax
    low = ax if swap else ay
    high = ay if swap else ax
    t = low / high
    t = t if t <= 1.0 else 0.0  # NaN must not become an index
    k = np.int32(t * 32.0 + 0.5)
    c = k / 32.0
    u = (t - c) / (1.0 + t * c)
    s = u * u
    angle = _ARCTAN[np.uint32(k)] + u * (
        1.0 - s * (1.0 / 3.0 - s * (0.2 - s * (1.0 / 7.0 - s * (1.0 / 9.0 - s * (1.0 / 11.0)))))
    )
    angle = HALF_PI - angle if swap else angle
    angle = PI - angle if x < 0.0 else angle
    return -angle if y < 0.0 else angle


@njit(cache=True, error_model="numpy")
def _sin_taylor(x: float) -> float:
    s = x * x
    return x * (
        1.0
        - s * (1.0 / 6.0) * (
            1.0
            - s * (1.0 / 20.0) * (
                1.0 - s * (1.0 / 42.0) * (1.0 - s * (1.0 / 72.0) * (1.0 - s * (1.0 / 110.0) * (1.0 - s * (1.0 / 156.0) * (1.0 - s * (1.0 / 210.0)))))
            )
        )
    )  # fmt: skip


@njit(cache=True, error_model="numpy")
def _cos_taylor(x: float) -> float:
    s = x * x
    return 1.0 - s * (1.0 / 2.0) * (
        1.0
        - s * (1.0 / 12.0) * (
            1.0
            - s * (1.0 / 30.0) * (
                1.0 - s * (1.0 / 56.0) * (1.0 - s * (1.0 / 90.0) * (1.0 - s * (1.0 / 132.0) * (1.0 - s * (1.0 / 182.0) * (1.0 - s * (1.0 / 240.0)))))
            )
        )
    )  # fmt: skip


@njit(cache=True, error_model="numpy")
def sin_cos(x: float) -> tuple[float, float]:
    """Return sine and cosine of ``x`` radians, for |x| up to some hundred turns."""
    quarter = np.floor(x / HALF_PI + 0.5)
    # The second term carries the part of pi / 2 that its float64 lacks.
    r = (x - quarter * HALF_PI) - quarter * 6.123233995736766e-17
    s = _sin_taylor(r)
    c = _cos_taylor(r)
    q = int(quarter) & 3
    if q == 0:
        return s, c
    if q == 1:
        return c, -s
    if q == 2:
        return -s, -c
    return -c, s


@lru_cache(maxsize=8)
def turn_tables(divisions: int) -> tuple[np.ndarray, np.ndarray]:
    """Return sine and cosine of ``2 pi k / divisions`` for every k in 0..divisions - 1, float64, not to be written to: those of 36,000 ticks take longer than most of what is done with them."""
    return _turn_tables(divisions)


@njit(cache=True, error_model="numpy")
def _turn_tables(divisions: int) -> tuple[np.ndarray, np.ndarray]:
    sines = np.empty(divisions)
    cosines = np.empty(divisions)
    for k in range(divisions):
        sines[k], cosines[k] = sin_cos(TWO_PI * k / divisions)
    return sines, cosines
