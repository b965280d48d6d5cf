"""The rays of lasers that turn steadily on a vehicle that moves: where a laser looked at a time, from a few numbers of a scan.

With the time t of a point (of the list, -1/2 to 1/2), its laser's elevation e and azimuth a, and of its sensor the place o, the rotation R
(a vector, by which :func:`~salpcc.stages.lattice.untwist.moved` turns), the turning rate w, and the motion (v, u) of the vehicle::

    ray = Q(t u) R (cos e cos(a + w t + c), cos e sin(a + w t + c), sin e)          origin = Q(t u) o + t v

c is what the sensor turned faster or slower, which decoded points tell (:mod:`.timed_coder`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.lattice.trig import sin_cos
from salpcc.stages.lattice.untwist import moved

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Turning:
    """Numbers of rays.

    Attributes:
        lasers: ``(L, 2)`` float32, elevation and azimuth of each, radians.
        sensors: ``(G, 7)`` float32: place (metres), rotation vector, turning rate of each sensor.
        motion: ``(6,)`` float32.
    """

    lasers: NDArray[np.float32]
    sensors: NDArray[np.float32]
    motion: NDArray[np.float32]


@njit(cache=True, error_model="numpy")
def ray_at(lasers, sensors, motion, laser, sensor, time, turned):  # type: ignore[no-untyped-def]
    """Return origin and direction of a ray, and the direction at right angles to it in which it turns; ``turned``: the angle c."""
    s = sensors[sensor]
    sin_e, cos_e = sin_cos(np.float64(lasers[laser, 0]))
    sin_a, cos_a = sin_cos(np.float64(lasers[laser, 1]) + np.float64(s[6]) * time + turned)
    still = (0.0, 0.0, 0.0, np.float64(s[3]), np.float64(s[4]), np.float64(s[5]))
    turn = (0.0, 0.0, 0.0, np.float64(motion[3]), np.float64(motion[4]), np.float64(motion[5]))
    x, y, z = moved(cos_e * cos_a, cos_e * sin_a, sin_e, 1.0, still)
    x, y, z = moved(x, y, z, time, turn)
    u, v, w = moved(-sin_a, cos_a, 0.0, 1.0, still)
    u, v, w = moved(u, v, w, time, turn)
    a, b, c = moved(np.float64(s[0]), np.float64(s[1]), np.float64(s[2]), time, turn)
    a += time * np.float64(motion[0])
    b += time * np.float64(motion[1])
    c += time * np.float64(motion[2])
    return (a, b, c), (x, y, z), (u, v, w)
