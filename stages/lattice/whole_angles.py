"""Points of whole counts and whole angles: how drivers of sensors make them whose rays are corrected by tables, such as Hesai's AT128 with its turning mirrors.

Azimuth (from y to x) and elevation are steps of 1/25600 degree. With the float32 angle of a step, its float32 sine and cosine as C libraries have
them (:mod:`.drivers.sines`), and the range, every product rounded to float32::

    angle(i) = 2 i * pi / TURN         d = count * unit         x = (d cos e) sin a         y = (d cos e) cos a         z = d sin e

What a table says of a laser at an azimuth is not asked here: it is whole steps.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.lattice.drivers.sines import POLYNOMIAL, cosine32, sine32
from salpcc.stages.lattice.trig import TWO_PI, arctan2

TURN = 9_216_000  # steps
UNITS = (0.005, 0.004, 0.002, 0.001)  # metres of a count
_PI, _TURN = np.float32(np.pi), np.float32(TURN)
_SAMPLE, _MOST = 500, 0.9  # points; share of them that a unit is taken for

F32 = NDArray[np.float32]
I64 = NDArray[np.int64]


@njit(cache=True, error_model="numpy")
def _sine_cosine(step: int) -> tuple[np.float32, np.float32]:
    angle = np.float32(np.float32(np.float32(2 * (step % TURN)) * _PI) / _TURN)
    return sine32(POLYNOMIAL, angle), cosine32(POLYNOMIAL, angle)


@njit(cache=True, error_model="numpy")
def make_points(azimuth: I64, elevation: I64, count: I64, unit: float) -> F32:
    """Return points ``(N, 3)`` of whole azimuths, elevations and counts ``(N,)``."""
    points = np.empty((len(count), 3), np.float32)
    for i in range(len(count)):
        d = np.float32(count[i] * unit)
        sin_a, cos_a = _sine_cosine(azimuth[i])
        sin_e, cos_e = _sine_cosine(elevation[i])
        rho = np.float32(d * cos_e)
        points[i, 0], points[i, 1] = np.float32(rho * sin_a), np.float32(rho * cos_a)
        points[i, 2] = np.float32(d * sin_e)
    return points


@njit(cache=True, error_model="numpy")
def _find(points: F32, unit: float, azimuth: I64, elevation: I64, count: I64) -> NDArray[np.bool_]:
    """Fill what points ``(N, 3)`` were made of; return which they are."""
    found = np.zeros(len(points), np.bool_)
    for i in range(len(points)):
        x, y, z = np.float64(points[i, 0]), np.float64(points[i, 1]), np.float64(points[i, 2])
        rho = np.sqrt(x * x + y * y)
        if not 0.0 < rho + abs(z) < 1e4:
            continue
        count[i] = np.int64(np.rint(np.sqrt(rho * rho + z * z) / unit))
        d = np.float32(count[i] * unit)
        level = np.int64(np.rint(arctan2(z, rho) * (TURN / TWO_PI)))
        ahead = np.int64(np.rint(arctan2(x, y) * (TURN / TWO_PI))) % TURN
        for e in (level, level - 1, level + 1):
            sin_e, cos_e = _sine_cosine(e)
            if np.float32(d * sin_e) != points[i, 2]:
                continue
            across = np.float32(d * cos_e)
            for a in (ahead, ahead - 1, ahead + 1):
                sin_a, cos_a = _sine_cosine(a)
                same = (
                    np.float32(across * sin_a) == points[i, 0] and np.float32(across * cos_a) == points[i, 1]
                )
                # Of two that make the same point, the even one: corrections are even steps.
                if same and (not found[i] or e % 2 < elevation[i] % 2):
                    found[i], elevation[i], azimuth[i] = True, e, a % TURN
    return found


def find_angles(points: F32) -> tuple[int, I64, I64, I64, NDArray[np.bool_]] | None:
    """Return the place of the unit in UNITS, azimuths, elevations and counts ``(N,)`` that points ``(N, 3)`` were made of, and which were; None where few are."""
    sample = np.ascontiguousarray(points[:: len(points) // _SAMPLE + 1])
    for place, unit in enumerate(UNITS):
        if _found(sample, unit)[3].mean() >= _MOST:
            azimuth, elevation, count, found = _found(points, unit)
            return place, azimuth, elevation, count, found
    return None


def _found(points: F32, unit: float) -> tuple[I64, I64, I64, NDArray[np.bool_]]:
    azimuth, elevation, count = np.zeros((3, len(points)), np.int64)
    found = _find(points, unit, azimuth, elevation, count)
    # A zero may have another sign.
    found &= (make_points(azimuth, elevation, count, unit).view(np.int32) == points.view(np.int32)).all(
        axis=1
    )
    return azimuth, elevation, count, found
