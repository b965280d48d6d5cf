"""Motion compensation of a scan, and its exact inversion (SENSOR_LATTICE.md, section 2).

KITTI odometry scans are raw scans moved by the vehicle's motion ``(v, w)`` during the turn::

    P = R(s w) q + s v        s = atan2(q_y, q_x) / (2 pi)

``q`` is a raw point: float32 of a whole number of millimetres. That lattice is the measuring stick:
the right ``(v, w)`` is the one that puts every point back on it, and the lattice holds no noise, so
six numbers follow from a few hundred points and everything else confirms them.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.ingest.trig import TWO_PI, arctan2

# Points of a fitted scan are off the 1 mm lattice by float32 rounding only (about 0.0005 mm); phases of
# a wrong motion are uniform, 0.29 mm rms, and next to none of them is near 0 on all axes.
_ON_LATTICE = 1e-5  # metres
_LOCKED_SHARE = 0.5
_FARTHEST = 1e4  # metres
_GROWING_MM = 0.15
_POINTS_PER_ROUND = 1000
_POINTS_TO_POLISH = 8000
_NEAR_FIRST = 0.003  # turns
_NEAR = 15.0  # metres
_FIRST_SECTOR = 0.0006  # turns; the displacement there is below 1 mm up to 20 m/s when started right
_WARM_SECTOR = 0.03  # the motion changes little from one scan to the next
_START_SPEEDS = tuple(-0.3 * k for k in range(-2, 14))  # metres per turn, forward is negative
_START_YAW_RATES = (0.0, -0.05, 0.05, -0.1, 0.1)  # radians per turn


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
def _inverse(x: float, y: float, z: float, m: NDArray[np.float64], branch: int) -> tuple[float, float, float]:
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
def _fit(
    points: NDArray[np.float64],
    chosen: NDArray[np.int64],
    start: NDArray[np.float64],
    rounds: int,
    by_ulp: bool,
) -> tuple[NDArray[np.float64], float, float]:
    """Gauss-Newton on the distance to the lattice over the chosen points.

    ``by_ulp`` weighs each coordinate by the inverse of its float32 step, which is the noise of a
    published value: only then do the last bits come out right.

    Returns the motion, the rms misfit in mm, and the share of points that lie on the lattice.
    """
    m = start.copy()
    misfit = np.inf
    close = 0
    for _ in range(rounds):
        h = np.zeros((6, 6))
        g = np.zeros(6)
        j = np.zeros((3, 6))
        square = 0.0
        close = 0
        for i in chosen:
            px = points[i, 0]
            py = points[i, 1]
            pz = points[i, 2]
            qx, qy, qz = _inverse(px, py, pz, m, 0)
            qx = on_lattice(qx)
            qy = on_lattice(qy)
            qz = on_lattice(qz)
            s = arctan2(qy, qx) / TWO_PI
            fx, fy, fz = forward(qx, qy, qz, m)
            ax = fx - s * m[0]
            ay = fy - s * m[1]
            az = fz - s * m[2]
            j[0, 0] = s
            j[1, 1] = s
            j[2, 2] = s
            j[0, 4] = s * az
            j[0, 5] = -s * ay
            j[1, 3] = -s * az
            j[1, 5] = s * ax
            j[2, 3] = s * ay
            j[2, 4] = -s * ax
            e = (px - fx, py - fy, pz - fz)
            off = max(abs(e[0]), abs(e[1]), abs(e[2]))
            if off < _ON_LATTICE:
                close += 1
            elif by_ulp:
                continue  # not a point of the lattice at all
            p = (px, py, pz)
            square += e[0] * e[0] + e[1] * e[1] + e[2] * e[2]
            for c in range(3):
                weight = 1.0
                if by_ulp:
                    # 1e-5: below that the float64 of the model itself is the noise.
                    weight = 1.0 / max(abs(p[c]), 1e-5) ** 2
                for a in range(6):
                    wj = weight * j[c, a]
                    if wj != 0.0:
                        g[a] += wj * e[c]
                        for b in range(a, 6):
                            h[a, b] += wj * j[c, b]
        for a in range(6):
            h[a, a] = h[a, a] * (1.0 + 1e-12) + 1e-12
            for b in range(a):
                h[a, b] = h[b, a]
        misfit = 1000.0 * np.sqrt(square / (3 * max(len(chosen), 1)))
        change = np.linalg.solve(h, g)
        m = m + change
        if np.abs(change).max() < 1e-9:
            break
    return m, misfit, close / max(len(chosen), 1)


def _grow(
    points: NDArray[np.float64], turns: NDArray[np.float64], start: NDArray[np.float64], sector: float
) -> NDArray[np.float64] | None:
    """Fit on a narrow sector around azimuth 0, widen it up to the full turn; None if phase is lost.

    Near azimuth 0 the displacement is almost nil, so the nearest lattice point is the right one; each
    fit is good enough to unwrap a sector three times as wide.
    """
    distance = np.hypot(points[:, 0], points[:, 1])
    motion = start
    while True:
        inside = np.flatnonzero(turns < min(sector, 0.495))
        if sector < _NEAR_FIRST:  # the yaw rate moves far points most
            inside = inside[distance[inside] < _NEAR]
        if len(inside) < 12:
            return None
        chosen = inside[:: max(1, len(inside) // _POINTS_PER_ROUND)]
        motion, misfit, share = _fit(points, chosen, motion, 6, False)
        if misfit > _GROWING_MM or not np.isfinite(motion).all():
            return None
        if sector >= 0.495:
            return motion if share > _LOCKED_SHARE else None
        sector *= 3.0


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
            qx, qy, qz = _inverse(x, y, z, motion, branch) if moving else (x, y, z)
            raw[i, 0] = np.int64(np.rint(qx * 1000.0))
            raw[i, 1] = np.int64(np.rint(qy * 1000.0))
            raw[i, 2] = np.int64(np.rint(qz * 1000.0))
            qx, qy, qz = on_lattice(qx), on_lattice(qy), on_lattice(qz)
            fx, fy, fz = forward(qx, qy, qz, motion) if moving else (qx, qy, qz)
            again[i, 0] = fx
            again[i, 1] = fy
            again[i, 2] = fz
            if abs(fx - x) < _ON_LATTICE and abs(fy - y) < _ON_LATTICE and abs(fz - z) < _ON_LATTICE:
                good[i] = True
                break
    return raw, again, good


def is_raw(points: NDArray[np.float32]) -> bool:
    """Tell whether points ``(N, 3)`` lie on the 1 mm lattice as they are (no motion compensation)."""
    sample = points[:: max(1, len(points) // 2000)].astype(np.float64)
    nearest = (np.rint(sample * 1000.0) / 1000.0).astype(np.float32)
    return bool((nearest == sample).all(axis=1).mean() > 0.99)


def solve_motion(
    points: NDArray[np.float32], start: NDArray[np.float64] | None = None
) -> NDArray[np.float64] | None:
    """Find the motion ``(6,)`` that a compensated scan ``(N, 3)`` was compensated with.

    Args:
        start: the motion of the scan before, if there is one; without it a grid of forward speeds
            and yaw rates is tried.

    Returns:
        ``(v, w)`` in metres and radians per turn, or None if no motion puts the scan on the lattice.
    """
    exact = points.astype(np.float64)
    turns = np.abs(np.arctan2(exact[:, 1], exact[:, 0])) / TWO_PI
    motion = None if start is None else _grow(exact, turns, start, _WARM_SECTOR)
    if motion is None:
        for yaw in _START_YAW_RATES:
            for speed in _START_SPEEDS:
                guess = np.array([speed, 0.0, 0.0, 0.0, 0.0, yaw])
                motion = _grow(exact, turns, guess, _FIRST_SECTOR)
                if motion is not None:
                    break
            if motion is not None:
                break
    if motion is None:
        return None
    return _fit(exact, _sharpest(exact, turns), motion, 3, True)[0]


def _sharpest(points: NDArray[np.float64], turns: NDArray[np.float64]) -> NDArray[np.int64]:
    """Pick the points that say most about the motion: far round the turn, one coordinate near 0.

    There float32 is finest. Near half a turn the branch of s is uncertain.
    """
    leverage = np.where(turns < 0.499, turns, 0.0)[:, None] / np.maximum(np.abs(points), 1e-4)
    count = min(_POINTS_TO_POLISH // 3, len(points) - 1)
    best = [np.argpartition(leverage[:, c], -count)[-count:] for c in range(3)]
    return np.unique(np.concatenate(best))


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
