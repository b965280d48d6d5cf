"""Motion compensation of a scan, and its exact inversion (docs/sensor_lattice.md, section 2).

KITTI odometry scans are raw scans moved by the vehicle's motion ``(v, w)`` during the turn::

    P = R(s w) q + s v        s = atan2(q_y, q_x) / (2 pi)

``q`` is a raw point: float32 of a whole number of millimetres. :mod:`.motion_search` finds ``(v, w)``.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.lattice.trig import TWO_PI, arctan2

# Points of a fitted scan are off the 1 mm lattice by float32 rounding only (about 0.0005 mm).
ON_LATTICE = 1e-5  # metres
_FARTHEST = 1e4  # metres
BLOCK = 512  # points whose coordinates stand apart in short columns, so that loops become vector instructions

Motion = NDArray[np.float64] | tuple[float, float, float, float, float, float]


@njit(cache=True, error_model="numpy", inline="always")
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


@njit(cache=True, error_model="numpy", inline="always")
def forward(x: float, y: float, z: float, m: Motion) -> tuple[float, float, float]:
    """Move one raw point by the motion m."""
    return moved(x, y, z, arctan2(y, x) / TWO_PI, m)


@njit(cache=True, error_model="numpy", inline="always")
def moved(x: float, y: float, z: float, s: float, m: Motion) -> tuple[float, float, float]:
    """Move a point by the part ``s`` of a turn's motion m."""
    px, py, pz = _rotate(x, y, z, s * m[3], s * m[4], s * m[5])
    return px + s * m[0], py + s * m[1], pz + s * m[2]


@njit(cache=True, error_model="numpy", inline="always")
def turned_back(x: float, y: float, z: float, s: float, m: Motion) -> tuple[float, float, float]:
    """Undo the motion of a point whose s is known."""
    return _rotate(x - s * m[0], y - s * m[1], z - s * m[2], -s * m[3], -s * m[4], -s * m[5])


@njit(cache=True, error_model="numpy")
def _branched(s: float, branch: int) -> float:
    return s + branch if branch != 0 and s * branch < 0.0 else s


@njit(cache=True, error_model="numpy", inline="always")
def _correction(x, y, qx, qy, s0, c, s):  # type: ignore[no-untyped-def]
    """By how much s is off where the motion undone by it leaves (qx, qy), and the tangent of the turn between the two."""
    t = (x * qy - y * qx) / (x * qx + y * qy)
    t2 = t * t
    angle = t * (1.0 - t2 * (1.0 / 3.0 - t2 * (0.2 - t2 * (1.0 / 7.0))))
    return (s0 + angle * (1.0 / TWO_PI) - s) / (1.0 - c), t


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
    qx, qy, qz = turned_back(x, y, z, s, m)
    if rho2 > 4.0:
        for _ in range(4):
            change, t = _correction(x, y, qx, qy, s0, c, s)
            s += change
            qx, qy, qz = turned_back(x, y, z, s, m)
            if abs(change) < 1e-5:
                break
        if abs(t) < 0.2:
            return qx, qy, qz
    for _ in range(12):
        s = _branched(arctan2(qy, qx) / TWO_PI, branch)
        qx, qy, qz = turned_back(x, y, z, s, m)
    return qx, qy, qz


@njit(cache=True, error_model="numpy", inline="always")
def _newton(x, y, z, s0, c, s, m):  # type: ignore[no-untyped-def]
    """One Newton step of :func:`inverse` from s on: the next s, whether it is the last, and whether it holds."""
    qx, qy, _ = turned_back(x, y, z, s, m)
    change, t = _correction(x, y, qx, qy, s0, c, s)
    return s + change, abs(change) < 1e-5, abs(t) < 0.2


@njit(cache=True, error_model="numpy", inline="always")
def inverse_in_two(x: float, y: float, z: float, m: Motion) -> tuple[float, float, float, bool]:
    """:func:`inverse` (branch 0) where two Newton steps end it, without branches; the last value tells whether they do."""
    s0 = arctan2(y, x) / TWO_PI
    rho2 = x * x + y * y
    c = ((y * m[0] - x * m[1]) / rho2 - m[5]) * (1.0 / TWO_PI)
    s1, ends1, holds1 = _newton(x, y, z, s0, c, s0 / (1.0 - c), m)
    s2, ends2, holds2 = _newton(x, y, z, s0, c, s1, m)
    qx, qy, qz = turned_back(x, y, z, s1 if ends1 else s2, m)
    return qx, qy, qz, (rho2 > 4.0) & (ends1 | ends2) & (holds1 if ends1 else holds2)


@njit(cache=True, error_model="numpy", nogil=True)
def twist(raw: NDArray[np.float64], motion: NDArray[np.float64]) -> NDArray[np.float64]:
    """Compensate raw points ``(N, 3)`` in metres for the motion ``(6,)``; the published ones are its float32."""
    n = len(raw)
    out = np.empty((n, 3))
    m = (motion[0], motion[1], motion[2], motion[3], motion[4], motion[5])
    block = np.empty((3, BLOCK))
    x, y, z = block[0], block[1], block[2]
    for start in range(0, n, BLOCK):
        size = min(BLOCK, n - start)
        for i in range(size):
            x[i], y[i], z[i] = raw[start + i, 0], raw[start + i, 1], raw[start + i, 2]
        for i in range(size):
            x[i], y[i], z[i] = forward(x[i], y[i], z[i], m)
        for i in range(size):
            out[start + i, 0], out[start + i, 1], out[start + i, 2] = x[i], y[i], z[i]
    return out


@njit(cache=True, error_model="numpy", inline="always")
def on_lattice(x: float, correction: int = 0) -> float:
    """Nearest raw coordinate: float32 of a whole number of millimetres, and no -0.0."""
    return np.float64(np.float32((np.rint(x * 1000.0) + correction) / 1000.0 + 0.0))


@njit(cache=True, error_model="numpy")
def returns(points: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Mark the points ``(N, 3)`` that are finite, within 10 km, and not all zeros, as what is no return often is."""
    marked = np.empty(len(points), np.bool_)
    for i in range(len(points)):
        x, y, z = abs(points[i, 0]), abs(points[i, 1]), abs(points[i, 2])
        marked[i] = (x < _FARTHEST) & (y < _FARTHEST) & (z < _FARTHEST) & ((x > 0.0) | (y > 0.0) | (z > 0.0))
    return marked


@njit(cache=True, error_model="numpy", inline="always")
def _near_inverse(x: float, y: float, z: float, m: Motion) -> tuple[float, float, float]:
    """:func:`inverse` of points that are neither near the seam nor near the axis, without branches."""
    s0 = arctan2(y, x) / TWO_PI
    c = ((y * m[0] - x * m[1]) / (x * x + y * y) - m[5]) * (1.0 / TWO_PI)
    s = s0 / (1.0 - c)
    qx, qy, _ = turned_back(x, y, z, s, m)
    t = (x * qy - y * qx) / (x * qx + y * qy)
    s += (s0 + t * (1.0 - t * t * (1.0 / 3.0)) * (1.0 / TWO_PI) - s) / (1.0 - c)
    return turned_back(x, y, z, s, m)


@njit(cache=True, error_model="numpy", inline="always")
def _again(qx: float, qy: float, qz: float, m: Motion, moving: bool) -> tuple[float, float, float]:
    """Round a raw point to the lattice and move it forward again."""
    qx, qy, qz = on_lattice(qx), on_lattice(qy), on_lattice(qz)
    fx, fy, fz = forward(qx, qy, qz, m)
    return (fx if moving else qx), (fy if moving else qy), (fz if moving else qz)


@njit(cache=True, error_model="numpy")
def _by_branches(x, y, z, motion, raw, again):  # type: ignore[no-untyped-def]
    """Untwist one point by every branch of s that it may have; fill its rows, tell whether one explains it."""
    near_seam = x < 0.0 and abs(y) < -0.1 * x
    for branch in (0, 1, -1):
        if branch != 0 and not near_seam:
            break
        qx, qy, qz = inverse(x, y, z, motion, branch)
        raw[0], raw[1], raw[2] = np.rint(qx * 1000.0), np.rint(qy * 1000.0), np.rint(qz * 1000.0)
        again[0], again[1], again[2] = _again(qx, qy, qz, motion, True)
        if (
            abs(again[0] - x) < ON_LATTICE
            and abs(again[1] - y) < ON_LATTICE
            and abs(again[2] - z) < ON_LATTICE
        ):
            return True
    return False


@njit(cache=True, error_model="numpy")
def _untwist(
    points: NDArray[np.float32], motion: NDArray[np.float64], moving: bool
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.bool_]]:
    n = len(points)
    raw = np.empty((n, 3), np.int64)
    again = np.empty((n, 3))
    good = np.empty(n, np.bool_)
    m = (motion[0], motion[1], motion[2], motion[3], motion[4], motion[5])
    block = np.empty((6, BLOCK))
    x, y, z, fx, fy, fz = block[0], block[1], block[2], block[3], block[4], block[5]
    off = np.empty(BLOCK)
    for start in range(0, n, BLOCK):
        size = min(BLOCK, n - start)
        for i in range(size):
            x[i], y[i], z[i] = points[start + i, 0], points[start + i, 1], points[start + i, 2]
        for i in range(size):
            px, py, pz = x[i], y[i], z[i]
            qx, qy, qz = _near_inverse(px, py, pz, m)
            qx, qy, qz = (qx if moving else px), (qy if moving else py), (qz if moving else pz)
            fx[i], fy[i], fz[i] = _again(qx, qy, qz, m, moving)
            x[i], y[i], z[i] = qx, qy, qz
            off[i] = max(max(abs(fx[i] - px), abs(fy[i] - py)), abs(fz[i] - pz))
        for i in range(size):
            px, py, pz = points[start + i, 0], points[start + i, 1], points[start + i, 2]
            if not (abs(px) < _FARTHEST and abs(py) < _FARTHEST and abs(pz) < _FARTHEST):
                raw[start + i] = 0
                again[start + i] = 0.0
                good[start + i] = False
                continue
            raw[start + i, 0], raw[start + i, 1] = np.rint(x[i] * 1000.0), np.rint(y[i] * 1000.0)
            raw[start + i, 2] = np.rint(z[i] * 1000.0)
            again[start + i, 0], again[start + i, 1], again[start + i, 2] = fx[i], fy[i], fz[i]
            good[start + i] = off[i] < ON_LATTICE
            if moving and not off[i] < ON_LATTICE:
                good[start + i] = _by_branches(
                    np.float64(px), np.float64(py), np.float64(pz), motion, raw[start + i], again[start + i]
                )
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
