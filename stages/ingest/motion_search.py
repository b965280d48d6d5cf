"""Find the motion that a scan was compensated with (SENSOR_LATTICE.md, section 2).

The 1 mm lattice of the raw points is the measuring stick: the right ``(v, w)`` puts every point back on
it, and the lattice holds no noise, so six numbers follow from a few hundred points and everything else
confirms them.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.ingest.trig import TWO_PI, arctan2
from salpcc.stages.ingest.untwist import ON_LATTICE, forward, inverse, on_lattice

# Points of a fitted scan are off the 1 mm lattice by float32 rounding only (about 0.0005 mm); phases of
# a wrong motion are uniform, 0.29 mm rms, and next to none of them is near 0 on all axes.
_LOCKED_SHARE = 0.5
_GROWING_MM = 0.15
_POINTS_PER_ROUND = 1000
_POINTS_TO_POLISH = 8000
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
            qx, qy, qz = inverse(px, py, pz, m, 0)
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
            if off < ON_LATTICE:
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


@njit(cache=True, error_model="numpy")
def _polar(points: NDArray[np.float64]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """How far each point lies from azimuth 0, in turns, and from the axis, in metres."""
    turns, distance = np.empty(len(points), np.float32), np.empty(len(points), np.float32)
    for i in range(len(points)):
        turns[i] = abs(arctan2(points[i, 1], points[i, 0])) / TWO_PI
    for i in range(len(points)):
        distance[i] = np.sqrt(points[i, 0] * points[i, 0] + points[i, 1] * points[i, 1])
    return turns, distance


def _grow(
    points: NDArray[np.float64],
    turns: NDArray[np.float32],
    distance: NDArray[np.float32],
    start: NDArray[np.float64],
    sector: float,
) -> NDArray[np.float64] | None:
    """Fit on a narrow sector around azimuth 0, widen it up to the full turn; None if phase is lost.

    Near azimuth 0 the displacement is almost nil, so the nearest lattice point is the right one; each
    fit is good enough to unwrap a sector three times as wide.
    """
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
    turns, distance = _polar(exact)
    motion = None if start is None else _grow(exact, turns, distance, start, _WARM_SECTOR)
    if motion is None:
        for yaw in _START_YAW_RATES:
            for speed in _START_SPEEDS:
                guess = np.array([speed, 0.0, 0.0, 0.0, 0.0, yaw])
                motion = _grow(exact, turns, distance, guess, _FIRST_SECTOR)
                if motion is not None:
                    break
            if motion is not None:
                break
    if motion is None:
        return None
    return _fit(exact, _sharpest(exact, turns), motion, 3, True)[0]


@njit(cache=True, error_model="numpy")
def _leverage(points: NDArray[np.float64], turns: NDArray[np.float32], c: int) -> NDArray[np.float32]:
    """What coordinate ``c`` of each point says about the motion. Near half a turn the branch of s is uncertain."""
    leverage = np.empty(len(points), np.float32)
    for i in range(len(points)):
        turn = turns[i] if turns[i] < np.float32(0.499) else np.float32(0.0)
        leverage[i] = turn / max(np.float32(abs(points[i, c])), np.float32(1e-4))
    return leverage


def _sharpest(points: NDArray[np.float64], turns: NDArray[np.float32]) -> NDArray[np.int64]:
    """Pick the points that say most about the motion: far round the turn, one coordinate near 0.

    There float32 is finest.
    """
    count = min(_POINTS_TO_POLISH // 3, len(points) - 1)
    best = [np.argpartition(_leverage(points, turns, c), -count)[-count:] for c in range(3)]
    return np.unique(np.concatenate(best))
