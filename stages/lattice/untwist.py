"""Motion compensation of a scan, and its exact inversion (docs/sensor_lattice.md, section 2).

KITTI odometry scans are raw scans moved by the vehicle's motion ``(v, w)`` during the turn::

    P = R(s w) q + s v        s = atan2(q_y, q_x) / (2 pi)

``q`` is a raw point: float32 of a whole number of millimetres. :mod:`.motion_search` finds ``(v, w)``.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.lattice.lattice import correction_code
from salpcc.stages.lattice.near_inverse import F, near_inverse
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
def _metres(millimetres: float) -> float:
    """A raw coordinate: float32 of a whole number of millimetres, and no -0.0."""
    return np.float64(np.float32(millimetres / 1000.0 + 0.0))


@njit(cache=True, error_model="numpy", inline="always")
def on_lattice(x: float, correction: int = 0) -> float:
    """Nearest raw coordinate."""
    return _metres(np.rint(x * 1000.0) + correction)


@njit(cache=True, error_model="numpy", inline="always")
def _millimetres(x: float) -> float:
    """Nearest whole number of millimetres; 0 of what is not finite or beyond 10 km, which must not become an integer."""
    return np.rint(np.float64(x) * 1000.0) if abs(x) < _FARTHEST else 0.0


@njit(cache=True, error_model="numpy")
def returns(points: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Mark the points ``(N, 3)`` that are finite, within 10 km, and not all zeros, as what is no return often is."""
    marked = np.empty(len(points), np.bool_)
    for i in range(len(points)):
        x, y, z = abs(points[i, 0]), abs(points[i, 1]), abs(points[i, 2])
        marked[i] = (x < _FARTHEST) & (y < _FARTHEST) & (z < _FARTHEST) & ((x > 0.0) | (y > 0.0) | (z > 0.0))
    return marked


class Untwisted(NamedTuple):
    """Points ``(N, 3)`` with their motion undone.

    Attributes:
        raw: int32, whole millimetres.
        azimuth: of the raw points, in [-pi, pi], ``(N,)`` float64.
        ulp: codes int8 ``(N,)`` of the last bits by which the points are off the raw ones moved forward, as :func:`~.lattice.correction_code` has them.
        explained: per point, whether the two roundings explain it to 0.01 mm. Points that are not finite or beyond 10 km do not count as explained.
    """

    raw: NDArray[np.int32]
    azimuth: NDArray[np.float64]
    ulp: NDArray[np.int8]
    explained: NDArray[np.bool_]


@njit(cache=True, error_model="numpy", inline="always")
def _off(value, given):  # type: ignore[no-untyped-def]
    """By how many last bits a float32, given as its bits, is off a value."""
    bits, given = np.int64(np.float32(value).view(np.int32)), np.int64(given)
    return (given ^ 0x7FFFFFFF if given < 0 else given) - (bits ^ 0x7FFFFFFF if bits < 0 else bits)


@njit(cache=True, error_model="numpy")
def _by_branches(x, y, z, motion, raw):  # type: ignore[no-untyped-def]
    """Untwist one point by every branch of s that it may have; return it moved forward again, and whether one explains it."""
    near_seam = x < 0.0 and abs(y) < -0.1 * x
    for branch in (0, 1, -1):
        qx, qy, qz = inverse(x, y, z, motion, branch)
        raw[0], raw[1], raw[2] = np.rint(qx * 1000.0), np.rint(qy * 1000.0), np.rint(qz * 1000.0)
        fx, fy, fz = forward(on_lattice(qx), on_lattice(qy), on_lattice(qz), motion)
        explained = max(max(abs(fx - x), abs(fy - y)), abs(fz - z)) < ON_LATTICE
        if explained or not near_seam:
            break
    return fx, fy, fz, explained


@njit(cache=True, error_model="numpy")
def _untwist(
    points: NDArray[np.float32], bits: NDArray[np.int32], motion: NDArray[np.float64], moving: bool
) -> Untwisted:
    n = len(points)
    raw, azimuth = np.empty((n, 3), np.int32), np.empty(n)
    ulp, good = np.empty(n, np.int8), np.empty(n, np.bool_)
    m = (motion[0], motion[1], motion[2], motion[3], motion[4], motion[5])
    near = (F(m[0]), F(m[1]), F(m[2]), F(m[3]), F(m[4]), F(m[5]))
    # Columns, and loops that do one thing, become vector instructions.
    given, block = np.empty((6, BLOCK), np.float32), np.empty((4, BLOCK))
    px, py, pz, qx, qy, qz = given[0], given[1], given[2], given[3], given[4], given[5]
    x, y, z, off = block[0], block[1], block[2], block[3]
    for start in range(0, n, BLOCK):
        size = min(BLOCK, n - start)
        for i in range(size):
            px[i], py[i], pz[i] = points[start + i, 0], points[start + i, 1], points[start + i, 2]
        if moving:
            for i in range(size):
                qx[i], qy[i], qz[i] = near_inverse(px[i], py[i], pz[i], near)
        else:
            qx[:], qy[:], qz[:] = px, py, pz
        for i in range(size):
            x[i], y[i], z[i] = _millimetres(qx[i]), _millimetres(qy[i]), _millimetres(qz[i])
        for i in range(size):
            raw[start + i, 0], raw[start + i, 1], raw[start + i, 2] = x[i], y[i], z[i]
        for i in range(size):
            x[i], y[i], z[i] = _metres(x[i]), _metres(y[i]), _metres(z[i])
        for i in range(size):
            azimuth[start + i] = arctan2(y[i], x[i])
        if moving:
            for i in range(size):
                x[i], y[i], z[i] = moved(x[i], y[i], z[i], azimuth[start + i] / TWO_PI, m)
        for i in range(size):
            off[i] = max(max(abs(x[i] - px[i]), abs(y[i] - py[i])), abs(z[i] - pz[i]))
        for i in range(size):
            good[start + i] = off[i] < ON_LATTICE
        for i in range(size):
            ulp[start + i] = correction_code(
                _off(x[i], bits[start + i, 0]), _off(y[i], bits[start + i, 1]), _off(z[i], bits[start + i, 2])
            )
        if moving:
            for i in range(size):
                at, far = start + i, not max(max(abs(px[i]), abs(py[i])), abs(pz[i])) < _FARTHEST
                if good[at] or far:
                    continue
                fx, fy, fz, good[at] = _by_branches(
                    np.float64(px[i]), np.float64(py[i]), np.float64(pz[i]), motion, raw[at]
                )
                azimuth[at] = arctan2(raw[at, 1] / 1000.0, raw[at, 0] / 1000.0)
                ulp[at] = correction_code(_off(fx, bits[at, 0]), _off(fy, bits[at, 1]), _off(fz, bits[at, 2]))
    return Untwisted(raw, azimuth, ulp, good)


def untwist(points: NDArray[np.float32], motion: NDArray[np.float64] | None) -> Untwisted:
    """Undo :func:`twist` (``motion`` None: the points ``(N, 3)`` are raw already)."""
    result: Untwisted = _untwist(
        points, points.view(np.int32), np.zeros(6) if motion is None else motion, motion is not None
    )
    return result
