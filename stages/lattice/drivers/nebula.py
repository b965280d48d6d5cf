"""Nebula's arithmetic for Velodynes: as :mod:`.velodyne`, but that hundredths of a degree are multiplied in float64, and the index has the laser's own azimuth in it.

With azimuth index i, and an azimuth offset r, which is 0 therefore::

    C[i], S[i] = cosine, sine of the float32 next to i * 0.01 degrees in radians, the products float64
    c, s, x, y, z: as of velodyne
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from salpcc.stages.lattice.drivers import hesai, velodyne
from salpcc.stages.lattice.drivers.velodyne import bearing, phase, row

__all__ = ["STEPS", "bearing", "phase", "row", "table"]

STEPS = 36_000  # azimuth indices in a turn
F32 = NDArray[np.float32]


@lru_cache(maxsize=4)
def table(sine: int) -> F32:
    """Return cosines and sines ``(STEPS, 2)`` of the azimuth indices, by the kind of :mod:`.sines`."""
    return velodyne.table_of(sine, hesai.table(sine)[:, 0])
