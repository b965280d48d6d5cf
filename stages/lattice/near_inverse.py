"""The inverse of the motion in float32: near enough to round to the 1 mm lattice, where float64 then checks it.

Good to some hundredths of a millimetre for points that are neither near the seam of the turn, nor near the axis, nor far away.
"""

from __future__ import annotations

import numpy as np
from numba import njit

F = np.float32
_ZERO, _QUARTER, _HALF, _ONE = F(0.0), F(0.25), F(0.5), F(1.0)
_THIRD, _SIXTH, _24TH, _PER_TURN = F(1 / 3), F(1 / 6), F(1 / 24), F(0.15915494309189535)
_A1, _A3, _A5, _A7, _A9 = F(0.9998660), F(-0.3302995), F(0.1801410), F(-0.0851330), F(0.0208351)


@njit(cache=True, error_model="numpy", inline="always")
def _turn_of(y, x):  # type: ignore[no-untyped-def]
    """Return the azimuth of (x, y) in turns, to 2e-6 (Abramowitz and Stegun 4.4.49); without branches."""
    ax, ay = abs(x), abs(y)
    t = min(ax, ay) / max(ax, ay)
    s = t * t
    turn = t * (_A1 + s * (_A3 + s * (_A5 + s * (_A7 + s * _A9)))) * _PER_TURN
    turn = _QUARTER - turn if ay > ax else turn
    turn = _HALF - turn if x < _ZERO else turn
    return -turn if y < _ZERO else turn


@njit(cache=True, error_model="numpy", inline="always")
def _turned_back(x, y, z, s, m):  # type: ignore[no-untyped-def]
    """Undo the part ``s`` of a turn's motion m."""
    x, y, z = x - s * m[0], y - s * m[1], z - s * m[2]
    wx, wy, wz = -s * m[3], -s * m[4], -s * m[5]
    t = wx * wx + wy * wy + wz * wz
    a, b = _ONE - t * _SIXTH, _HALF - t * _24TH
    cx, cy, cz = wy * z - wz * y, wz * x - wx * z, wx * y - wy * x
    return (
        x + a * cx + b * (wy * cz - wz * cy),
        y + a * cy + b * (wz * cx - wx * cz),
        z + a * cz + b * (wx * cy - wy * cx),
    )


@njit(cache=True, error_model="numpy", inline="always")
def near_inverse(x, y, z, m):  # type: ignore[no-untyped-def]
    """Undo the motion m of a point: :func:`.untwist.inverse` by one Newton step; all float32."""
    s0 = _turn_of(y, x)
    c = ((y * m[0] - x * m[1]) / (x * x + y * y) - m[5]) * _PER_TURN
    part = _ONE / (_ONE - c)
    s = s0 * part
    qx, qy, _ = _turned_back(x, y, z, s, m)
    t = (x * qy - y * qx) / (x * qx + y * qy)
    s += (s0 + t * (_ONE - t * t * _THIRD) * _PER_TURN - s) * part
    return _turned_back(x, y, z, s, m)
