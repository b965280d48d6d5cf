"""Hesai's arithmetic as ROS drivers have it: azimuths are hundredths of a degree, and every laser's own is added to them.

With azimuth index i and the laser's azimuth offset o in radians, all in float32::

    a = A[i] + o          A[i]: the float32 next to i * 0.01 degrees in radians
    x = (d cos e) sin a          y = (d cos e) cos a          z = d sin e
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.lattice.drivers.sines import cosine32, sine32
from salpcc.stages.lattice.trig import HALF_PI

STEPS = 36_000  # azimuth indices in a turn
F32 = NDArray[np.float32]


@lru_cache(maxsize=1)
def table(sine: int) -> F32:
    """Return the azimuths ``(STEPS, 1)`` of the indices, radians; they are of no kind of :mod:`.sines`."""
    return (np.arange(STEPS) * 0.01 * np.pi / 180.0).astype(np.float32).reshape(STEPS, 1)


@njit(cache=True, error_model="numpy", inline="always")
def bearing(sine: int, values: F32, index: int, offset: np.float32) -> tuple[np.float32, np.float32]:
    """What x and y are to the horizontal distance, of a laser of that azimuth offset."""
    azimuth = np.float32(values[index, 0] + offset)
    return sine32(sine, azimuth), cosine32(sine, azimuth)


def row(sine: int, offset: np.float32) -> tuple[np.float32, np.float32]:
    """The two numbers that a laser of that azimuth offset, in radians, has; the second is for others."""
    return np.float32(offset), np.float32(0.0)


def phase(offset: np.float32, _: np.float32) -> float:
    """Azimuth (counter-clockwise from x, radians) of index 0 of a laser of these numbers."""
    return HALF_PI - float(offset)
