"""Motion compensation of a scan, and its exact inversion (SENSOR_LATTICE.md, section 2).

KITTI odometry scans are raw scans moved by the vehicle's motion ``(v, w)`` during the turn::

    P = R(s w) q + s v        s = atan2(q_y, q_x) / (2 pi)

``q`` is a raw point: float32 of a whole number of millimetres. :mod:`.motion_search` finds ``(v, w)``.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.ingest.trig import TWO_PI, arctan2

# Points of a fitted scan are off the 1 mm lattice by float32 rounding only (about 0.0005 mm).
ON_LATTICE = 1e-5  # metres
_FARTHEST = 1e4  # metres


@njit(cache=True, error_model="numpy")
def _rotate(x: float, y: float, z: float, wx: float, wy: float, wz: float) -> tuple[float, float, float]:
    """Rodrigues' rotation of (x, y, z) by the small rotation vector w, by its series."""
    t = wx * wx + wy * wy + wz * wz
    a = 1.0 - t * (1.0 / 6.0) * (1.0 - t * (1.0 / 20.0) * (1.0 - t * (1.0 / 42.0) * (1.0 - t * (1.0 / 72.0))))
    b = 0.5 * (
        1.0
        - t * (1.0 / 12.0) * (1.0 - t * (1.0 / 30.0) * (1.0 - t * (1.0 / 56.0) * (1.0 - t * (1.0 / 90.0))))
    )
    cx = wy * z - wz * y
    cy = wz * x - wx * z
    cz = wx * y - wy * x
    return (
        x + a * cx + b * (wy * cz - wz * cy),
        y + a * cy + b * (wz * cx - wx * cz),
        z + a * cz + b * (wx * cy - wy * cx),
    )


@njit(cache=True, error_model="numpy")
def forward(x: float, y: float, z: float, m: NDArray[np.float64]) -> tuple[float, float, float]:
    """Move one raw point by the motion m."""
    s = arctan2(y, x) / TWO_PI
    px, py, pz = _rotate(x, y, z, s * m[3], s * m[4], s * m[5])
    return px + s * m[0], py + s * m[1], pz + s * m[2]


@njit(cache=True, error_model="numpy")
def _turned_back(
    x: float, y: float, z: float, s: float, m: NDArray[np.float64]
) -> tuple[float, float, float]:
    """Undo the motion of a point whose s is known."""
    return _rotate(x - s * m[0], y - s * m[1], z - s * m[2], -s * m[3], -s * m[4], -s * m[5])


@njit(cache=True, error_model="numpy")
def _branched(s: float, branch: int) -> float:
    return s + branch if branch != 0 and s * branch < 0.0 else s


@njit(cache=True, error_model="numpy")
def inverse(x: float, y: float, z: float, m: NDArray[np.float64], branch: int) -> tuple[float, float, float]:
    """Solve P(q) = (x, y, z) for q. ``branch`` of 1 or -1 moves s there by a turn.

    Undoing the motion turns the azimuth by about ``c s`` turns, so ``s = s0 / (1 - c)`` to first order, and
    Newton steps from there converge at once. Points within 2 m of the axis iterate.
    """
    s0 = _branched(arctan2(y, x) / TWO_PI, branch)
    rho2 = x * x + y * y
    c = ((y * m[0] - x * m[1]) / rho2 - m[5]) * (1.0 / TWO_PI)
    s = s0 / (1.0 - c)
    qx, qy, qz = _turned_back(x, y, z, s, m)
    if rho2 > 4.0:
        for _ in range(4):
            t = (x * qy - y * qx) / (x * qx + y * qy)
            t2 = t * t
            angle = t * (1.0 - t2 * (1.0 / 3.0 - t2 * (0.2 - t2 * (1.0 / 7.0))))
            change = (s0 + angle * (1.0 / TWO_PI) - s) / (1.0 - c)
            s += change
            qx, qy, qz = _turned_back(x, y, z, s, m)
            if abs(change) < 1e-5:
                break
        if abs(t) < 0.2:
            return qx, qy, qz
    for _ in range(12):
        s = _branched(arctan2(qy, qx) / TWO_PI, branch)
        qx, qy, qz = _turned_back(x, y, z, s, m)
    return qx, qy, qz


@njit(cache=True, error_model="numpy")
def twist(raw: NDArray[np.float64], motion: NDArray[np.float64]) -> NDArray[np.float64]:
    """Compensate raw points ``(N, 3)`` in metres for the motion ``(6,)``; the published ones are its float32."""
    n = raw.shape[0]
    out = np.empty((n, 3))
    for i in range(n):
        x, y, z = forward(raw[i, 0], raw[i, 1], raw[i, 2], motion)
        out[i, 0] = x
        out[i, 1] = y
        out[i, 2] = z
    return out


@njit(cache=True, error_model="numpy")
def on_lattice(x: float, correction: int = 0) -> float:
    """Nearest raw coordinate: float32 of a whole number of millimetres, and no -0.0."""
    return np.float64(np.float32((np.rint(x * 1000.0) + correction) / 1000.0 + 0.0))


@njit(cache=True, error_model="numpy")
def within_reach(points: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Mark the points ``(N, 3)`` that are finite and within 10 km."""
    within = np.zeros(len(points), np.bool_)
    for i in range(len(points)):
        within[i] = (
            abs(points[i, 0]) < _FARTHEST and abs(points[i, 1]) < _FARTHEST and abs(points[i, 2]) < _FARTHEST
        )
    return within


@njit(cache=True, error_model="numpy")
def _untwist(
    points: NDArray[np.float32], motion: NDArray[np.float64], moving: bool
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.bool_]]:
    n = len(points)
    raw = np.zeros((n, 3), np.int64)
    again = np.zeros((n, 3))
    good = np.zeros(n, np.bool_)
    for i in range(n):
        x = np.float64(points[i, 0])
        y = np.float64(points[i, 1])
        z = np.float64(points[i, 2])
        if not (abs(x) < _FARTHEST and abs(y) < _FARTHEST and abs(z) < _FARTHEST):
            continue
        near_seam = moving and x < 0.0 and abs(y) < -0.1 * x
        for branch in (0, 1, -1):
            if branch != 0 and not near_seam:
                break
            qx, qy, qz = inverse(x, y, z, motion, branch) if moving else (x, y, z)
            raw[i, 0] = np.int64(np.rint(qx * 1000.0))
            raw[i, 1] = np.int64(np.rint(qy * 1000.0))
            raw[i, 2] = np.int64(np.rint(qz * 1000.0))
            qx, qy, qz = on_lattice(qx), on_lattice(qy), on_lattice(qz)
            fx, fy, fz = forward(qx, qy, qz, motion) if moving else (qx, qy, qz)
            again[i, 0] = fx
            again[i, 1] = fy
            again[i, 2] = fz
            if abs(fx - x) < ON_LATTICE and abs(fy - y) < ON_LATTICE and abs(fz - z) < ON_LATTICE:
                good[i] = True
                break
    return raw, again, good


def untwist(
    points: NDArray[np.float32], motion: NDArray[np.float64] | None
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.bool_]]:
    """Undo :func:`twist` (``motion`` None: the points are raw already).

    Returns:
        raw points ``(N, 3)`` int64 in mm; those moved forward again, ``(N, 3)`` float64 in metres; and
        per point whether the two roundings explain the point to 0.01 mm. Points that are not finite or
        beyond 10 km do not count as explained.
    """
    return _untwist(points, np.zeros(6) if motion is None else motion, motion is not None)
