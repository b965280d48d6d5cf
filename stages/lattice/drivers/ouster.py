"""Ouster's arithmetic as its SDK has it: float64 throughout, rounded once; beams start beside the axis.

With the range r, the beam's elevation e and azimuth a off its column, the distance n of its origin from the axis and the height t of that, at
column v of ``steps``::

    E = 2 pi (steps - v) / steps          A = E - a          rho = (r - n) cos e
    x = -(rho cos A + n cos E)          y = -(rho sin A + n sin E)          z = (r - n) sin e + t
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.lattice.trig import PI, TWO_PI, sin_cos

MILLIDEGREES = PI / 180.0 / 1000.0  # radians
MICROMETRES = 1e-6
F32 = NDArray[np.float32]


@njit(cache=True, error_model="numpy")
def point(row: F32, tick: int, steps: int, distance: float) -> tuple[np.float32, np.float32, np.float32]:
    """Return x, y, z of a laser (e and a in millidegrees, n and t in micrometres), at a tick and a range in metres."""
    turned = TWO_PI * tick / steps
    sin_column, cos_column = sin_cos(turned)
    sin_a, cos_a = sin_cos(turned - np.float64(row[1]) * MILLIDEGREES)
    sin_e, cos_e = sin_cos(np.float64(row[0]) * MILLIDEGREES)
    n = np.float64(row[2]) * MICROMETRES
    r = distance - n
    rho = r * cos_e
    x = -(rho * cos_a + n * cos_column)
    y = -(rho * sin_a + n * sin_column)
    return np.float32(x), np.float32(y), np.float32(r * sin_e + np.float64(row[3]) * MICROMETRES)


def numbers(lasers: F32) -> tuple[NDArray[np.float64], ...]:
    """theta, z0, h, phi0, d0 ``(L,)`` of the sensor model that the formula comes to."""
    wide = lasers.astype(np.float64)
    theta, azimuth = wide[:, 0] * MILLIDEGREES, -wide[:, 1] * MILLIDEGREES
    n, height = wide[:, 2] * MICROMETRES, wide[:, 3] * MICROMETRES
    sin_e, cos_e = np.array([sin_cos(value) for value in theta]).T
    sin_a, cos_a = np.array([sin_cos(value) for value in azimuth]).T
    return theta, height - n * cos_a * (sin_e / cos_e), -n * sin_a, PI + azimuth, n * (cos_a / cos_e) - n
