"""Hesai's own driver for the Pandar64 and its kin: tables of sines and cosines of the azimuth index, turned by the laser's own angle, the axes half a turn on.

With the laser's angles (elevation e, azimuth offset o) and azimuth index i, all in float32::

    C[i], S[i] = cosine, sine of i * (2 pi / 36000)
    c = C[i] cos o - S[i] sin o          s = S[i] cos o + C[i] sin o
    x = -(d cos e) c          y = (d cos e) s          z = d sin e

The two numbers of a laser are cosine and sine of ``-o``, as of :mod:`.velodyne`, whose points these are with other tables, turned by half a turn.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.lattice.drivers import velodyne
from salpcc.stages.lattice.drivers.velodyne import row
from salpcc.stages.lattice.trig import arctan2

__all__ = ["STEPS", "bearing", "phase", "row", "table"]

STEPS = 36_000  # azimuth indices in a turn
F32 = NDArray[np.float32]


@lru_cache(maxsize=4)
def table(sine: int) -> F32:
    """Return cosines and sines ``(STEPS, 2)`` of the azimuth indices, by the kind of :mod:`.sines`."""
    return velodyne.table_of(sine, np.arange(STEPS, dtype=np.float32) * np.float32(2.0 * np.pi / STEPS))


@njit(cache=True, error_model="numpy", inline="always")
def bearing(values: F32, index: int, cos_r: np.float32, sin_r: np.float32) -> tuple[np.float32, np.float32]:
    """What x and y are to the horizontal distance, of a laser of azimuth offset -r."""
    u, v = velodyne.bearing(values, index, cos_r, sin_r)
    return -u, -v


def phase(cos_r: np.float32, sin_r: np.float32) -> float:
    """Azimuth (counter-clockwise from x, radians) of index 0 of a laser of these numbers."""
    return float(arctan2(-float(sin_r), -float(cos_r)))
