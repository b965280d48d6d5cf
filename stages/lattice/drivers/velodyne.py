"""Velodyne's arithmetic as ROS drivers have it: azimuths are hundredths of a degree, and index tables of sines and cosines.

With the laser's own angles (elevation e, azimuth offset r) and azimuth index i, all in float32::

    C[i], S[i] = cosine, sine of the float32 next to i * 0.01 degrees in radians
    c = C[i] cos r + S[i] sin r          s = S[i] cos r - C[i] sin r
    x = (d cos e) c          y = -(d cos e) s          z = d sin e
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.lattice.drivers.sines import cosine32, sine32
from salpcc.stages.lattice.trig import arctan2

STEPS = 36_000  # azimuth indices in a turn
F32 = NDArray[np.float32]


@lru_cache(maxsize=4)
def table(sine: int) -> F32:
    """Return cosines and sines ``(STEPS, 2)`` of the azimuth indices, by the kind of :mod:`.sines`."""
    degrees = (np.arange(STEPS, dtype=np.float32) * np.float32(0.01)).astype(np.float64)
    return table_of(sine, (degrees * (np.pi / 180.0)).astype(np.float32))


@njit(cache=True, error_model="numpy")
def table_of(sine: int, angles: F32) -> F32:
    """Return cosines and sines ``(N, 2)`` of float32 angles ``(N,)``, radians."""
    both = np.empty((len(angles), 2), np.float32)
    for i in range(len(angles)):
        both[i, 0], both[i, 1] = cosine32(sine, angles[i]), sine32(sine, angles[i])
    return both


@njit(cache=True, error_model="numpy", inline="always")
def bearing(values: F32, index: int, cos_r: np.float32, sin_r: np.float32) -> tuple[np.float32, np.float32]:
    """What x and y are to the horizontal distance, of a laser of azimuth offset r."""
    c, s = values[index, 0], values[index, 1]
    turned = np.float32(np.float32(c * cos_r) + np.float32(s * sin_r))
    aside = np.float32(np.float32(s * cos_r) - np.float32(c * sin_r))
    return turned, -aside


def row(sine: int, offset: np.float32) -> tuple[np.float32, np.float32]:
    """The two numbers that :func:`bearing` takes of a laser, from its azimuth offset in radians."""
    return cosine32(sine, offset), sine32(sine, offset)


def phase(cos_r: np.float32, sin_r: np.float32) -> float:
    """Azimuth (counter-clockwise from x, radians) of index 0 of a laser of these numbers."""
    return float(arctan2(float(sin_r), float(cos_r)))
