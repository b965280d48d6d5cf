"""Find the motion that a scan was compensated with (docs/sensor_lattice.md, section 2).

The 1 mm lattice of the raw points is the measuring stick: the right ``(v, w)`` puts every point back on
it, and the lattice holds no noise, so six numbers follow from a few hundred points and everything else
confirms them.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.lattice.trig import TWO_PI, arctan2
from salpcc.stages.lattice.untwist import ON_LATTICE, inverse, moved, on_lattice

F64 = NDArray[np.float64]

# Points of a fitted scan are off the 1 mm lattice by float32 rounding only (about 0.0005 mm); phases of
# a wrong motion are uniform, 0.29 mm rms, and next to none of them is near 0 on all axes.
_LOCKED_SHARE = 0.5
_GROWING_MM = 0.15
_POINTS_PER_ROUND = 500
_POINTS_TO_POLISH = 3000
_POINTS_TO_FOLLOW = 16000  # a scan from the motion of the one before
_NEAR_FIRST = 0.003  # turns
_NEAR = 15.0  # metres
_FIRST_SECTOR = 0.0006  # turns; the displacement there is below 1 mm up to 20 m/s when started right
_WARM_SECTOR = 0.03  # the motion changes little from one scan to the next
_START_SPEEDS = tuple(-0.3 * k for k in range(-2, 14))  # metres per turn, forward is negative
_START_YAW_RATES = (0.0, -0.05, 0.05, -0.1, 0.1)  # radians per turn


def is_raw(points: NDArray[np.float32]) -> bool:
    """Tell whether points ``(N, 3)`` lie on the 1 mm lattice as they are (no motion compensation)."""
    sample = points[:: max(1, len(points) // 2000)].astype(np.float64)
    nearest = (np.rint(sample * 1000.0) / 1000.0).astype(np.float32)
    return bool((nearest == sample).all(axis=1).mean() > 0.99)


@njit(cache=True, error_model="numpy", inline="always")
def _slopes(s, ax, ay, az, j):  # type: ignore[no-untyped-def]
    """Fill in how the moved point changes with the motion, ``(3, 6)``; (ax, ay, az) is the turned raw point."""
    j[0, 0] = j[1, 1] = j[2, 2] = s
    j[0, 4] = s * az
    j[0, 5] = -s * ay
    j[1, 3] = -s * az
    j[1, 5] = s * ax
    j[2, 3] = s * ay
    j[2, 4] = -s * ax


@njit(cache=True, error_model="numpy", inline="always")
def _gather(j, c, weight, error, h, g):  # type: ignore[no-untyped-def]
    """Add one coordinate's error to the normal equations (upper half)."""
    for a in range(6):
        wj = weight * j[c, a]
        g[a] += wj * error
        for b in range(a, 6):
            h[a, b] += wj * j[c, b]


@njit(cache=True, error_model="numpy")
def _change(h: NDArray[np.float64], g: NDArray[np.float64]) -> NDArray[np.float64]:
    """Solve the normal equations."""
    for a in range(6):
        h[a, a] = h[a, a] * (1.0 + 1e-12) + 1e-12
        for b in range(a):
            h[a, b] = h[b, a]
    return np.linalg.solve(h, g)  # type: ignore[return-value]


@njit(cache=True, error_model="numpy")
def _fit(
    points: NDArray[np.float32], chosen: NDArray[np.int64], start: NDArray[np.float64], rounds: int
) -> tuple[NDArray[np.float64], float, float]:
    """Gauss-Newton on the distance to the lattice over the chosen points.

    Returns the motion, the rms misfit in mm, and the share of points that lie on the lattice.
    """
    m = start.copy()
    misfit = np.inf
    close = 0
    j = np.zeros((3, 6))
    for _ in range(rounds):
        h = np.zeros((6, 6))
        g = np.zeros(6)
        square = 0.0
        close = 0
        for i in chosen:
            px, py, pz = np.float64(points[i, 0]), np.float64(points[i, 1]), np.float64(points[i, 2])
            qx, qy, qz = inverse(px, py, pz, m, 0)
            qx, qy, qz = on_lattice(qx), on_lattice(qy), on_lattice(qz)
            s = arctan2(qy, qx) / TWO_PI
            fx, fy, fz = moved(qx, qy, qz, s, m)
            _slopes(s, fx - s * m[0], fy - s * m[1], fz - s * m[2], j)
            e = (px - fx, py - fy, pz - fz)
            close += max(abs(e[0]), abs(e[1]), abs(e[2])) < ON_LATTICE
            square += e[0] * e[0] + e[1] * e[1] + e[2] * e[2]
            for c in range(3):
                _gather(j, c, 1.0, e[c], h, g)
        misfit = 1000.0 * np.sqrt(square / (3 * max(len(chosen), 1)))
        change = _change(h, g)
        m = m + change
        if np.abs(change).max() < 1e-9:
            break
    return m, misfit, close / max(len(chosen), 1)


@njit(cache=True, error_model="numpy")
def _polish(
    points: NDArray[np.float32], chosen: NDArray[np.int64], start: NDArray[np.float64], rounds: int
) -> NDArray[np.float64]:
    """Fit the chosen points, whose place on the lattice the start already tells, to the last bit.

    Each coordinate weighs by the inverse of its float32 step, which is the noise of a published value: only then do
    the last bits come out right.
    """
    m = start.copy()
    raw = np.empty((len(chosen), 4))
    for k in range(len(chosen)):
        p = points[chosen[k]]
        qx, qy, qz = inverse(np.float64(p[0]), np.float64(p[1]), np.float64(p[2]), m, 0)
        raw[k, 0], raw[k, 1], raw[k, 2] = on_lattice(qx), on_lattice(qy), on_lattice(qz)
        raw[k, 3] = arctan2(raw[k, 1], raw[k, 0]) / TWO_PI
    j = np.zeros((3, 6))
    for _ in range(rounds):
        h = np.zeros((6, 6))
        g = np.zeros(6)
        for k in range(len(chosen)):
            s = raw[k, 3]
            fx, fy, fz = moved(raw[k, 0], raw[k, 1], raw[k, 2], s, m)
            p = points[chosen[k]]
            e = (p[0] - fx, p[1] - fy, p[2] - fz)
            if max(abs(e[0]), abs(e[1]), abs(e[2])) < ON_LATTICE:
                _slopes(s, fx - s * m[0], fy - s * m[1], fz - s * m[2], j)
                for c in range(3):
                    # 1e-5: below that the float64 of the model itself is the noise.
                    _gather(j, c, 1.0 / max(abs(np.float64(p[c])), 1e-5) ** 2, e[c], h, g)
        change = _change(h, g)
        m = m + change
        if np.abs(change).max() < 1e-9:
            break
    return m


@njit(cache=True, error_model="numpy")
def _polar(points: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """How far each point lies from azimuth 0, in turns, and from the axis, in metres."""
    turns, distance = np.empty(len(points), np.float32), np.empty(len(points), np.float32)
    for i in range(len(points)):
        turns[i] = abs(arctan2(np.float64(points[i, 1]), np.float64(points[i, 0]))) / TWO_PI
    for i in range(len(points)):
        distance[i] = np.sqrt(points[i, 0] * points[i, 0] + points[i, 1] * points[i, 1])
    return turns, distance


def _grow(points: NDArray[np.float32], starts: Iterable[F64], sector: float) -> F64 | None:
    """Fit on a narrow sector around azimuth 0, widen it up to the full turn; None if phase is lost from all starts.

    Near azimuth 0 the displacement is almost nil, so the nearest lattice point is the right one; each
    fit is good enough to unwrap a sector three times as wide.
    """
    turns, distance = _polar(points)
    for start in starts:
        motion, width = start, sector
        while True:
            inside = np.flatnonzero(turns < min(width, 0.495))
            if width < _NEAR_FIRST:  # the yaw rate moves far points most
                inside = inside[distance[inside] < _NEAR]
            if len(inside) < 12:
                break
            chosen = np.ascontiguousarray(inside[:: max(1, len(inside) // _POINTS_PER_ROUND)])
            motion, misfit, share = _fit(points, chosen, motion, 6)
            if misfit > _GROWING_MM or not np.isfinite(motion).all():
                break
            if width >= 0.495:
                if share > _LOCKED_SHARE:
                    return motion
                break
            width *= 3.0
    return None


def _guesses() -> Iterator[F64]:
    for yaw in _START_YAW_RATES:
        for speed in _START_SPEEDS:
            yield np.array([speed, 0.0, 0.0, 0.0, 0.0, yaw])


def solve_motion(points: NDArray[np.float32], start: F64 | None = None) -> F64 | None:
    """Find the motion ``(6,)`` that a compensated scan ``(N, 3)`` was compensated with.

    Args:
        start: the motion of the scan before, if there is one; without it a grid of forward speeds
            and yaw rates is tried.

    Returns:
        ``(v, w)`` in metres and radians per turn, or None if no motion puts the scan on the lattice.
    """
    thin = np.ascontiguousarray(points[:: max(1, len(points) // _POINTS_TO_FOLLOW)])
    motion = None if start is None else _grow(thin, [start], _WARM_SECTOR)
    if motion is None:
        motion = _grow(points, _guesses(), _FIRST_SECTOR)
    return None if motion is None else _polish(points, _sharpest(points, _POINTS_TO_POLISH // 3), motion, 3)


@njit(cache=True, error_model="numpy")
def _sharpest(points: NDArray[np.float32], count: int) -> NDArray[np.int64]:
    """Pick the points that say most about the motion: far round the turn, one coordinate near 0, where float32 is finest.

    About ``count`` of each coordinate: those of the largest quarter octaves of turn over coordinate.
    """
    n = len(points)
    size = np.empty((3, n), np.int16)
    counts = np.zeros((3, 1 << 11), np.int64)
    for i in range(n):
        x, y = points[i, 0], points[i, 1]
        # As good as the angle here; half a turn is 2. There the branch of s is uncertain.
        turn = np.float32(1.0) - x / (abs(x) + abs(y))
        turn = turn if turn < np.float32(1.994) else np.float32(0.0)
        for c in range(3):
            leverage = turn / max(abs(points[i, c]), np.float32(1e-4))
            size[c, i] = np.float32(leverage).view(np.int32) >> 21
    for c in range(3):
        for i in range(n):
            counts[c, size[c, i]] += 1
    least = np.empty(3, np.int64)
    for c in range(3):
        bucket = (1 << 11) - 1
        total = counts[c, bucket]
        while bucket > 1 and total + counts[c, bucket - 1] <= count:
            bucket -= 1
            total += counts[c, bucket]
        least[c] = bucket
    chosen = np.empty(n, np.int64)
    found = 0
    for i in range(n):
        if size[0, i] >= least[0] or size[1, i] >= least[1] or size[2, i] >= least[2]:
            chosen[found] = i
            found += 1
    return chosen[:found]
