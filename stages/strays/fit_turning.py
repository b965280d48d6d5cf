"""Find the rays of :mod:`.turning_rays` that points lie on: a writer's part, which no reader repeats."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.strays.turning_rays import Turning

_FASTEST, _RATES = 8.0, 321  # radians from the first to the last point; tried
_SAMPLE = 6000  # points
_ROUNDS = 14
_HOPELESS = 0.02  # radians that half of the points are off by after half of the rounds
_DAMPING = 1e-6
_STEPS = np.array([1e-5, 1e-5, 1e-3, 1e-3, 1e-3, 1e-5, 1e-5, 1e-5, 1e-5, 1e-3, 1e-3, 1e-3, 1e-5, 1e-5, 1e-5])
_OF_LASER, _OF_SENSOR = 2, 7
_FEWEST = 10  # points of a laser

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]


def fit_turning(points: F64, laser: I64, group: I64, time: F64) -> tuple[Turning, float] | None:
    """Return the rays of points ``(N, 3)`` of lasers ``(N,)`` at times ``(N,)`` (-1/2 to 1/2), and how far off half of them are, radians.

    Args:
        group: the sensor of every laser that may be.
    """
    lasers, sensors = int(laser.max()) + 1, int(group[laser].max()) + 1
    reach = np.sqrt((points**2).sum(axis=1))
    sound = np.flatnonzero(np.isfinite(reach) & (reach > 0.5) & (reach < 1e4))
    if len(sound) < _SAMPLE // 4:
        return None
    some = np.random.default_rng(0).permutation(sound)[:_SAMPLE]
    p, k, t = points[some], laser[some], time[some]
    of = group[k]
    azimuth = np.arctan2(p[:, 1], p[:, 0])
    numbers = np.zeros((lasers, _OF_LASER)), np.zeros((sensors, _OF_SENSOR)), np.zeros(6)
    numbers[1][:, 6] = [_rate(azimuth[of == g], t[of == g], k[of == g], lasers) for g in range(sensors)]
    left = np.exp(1j * (azimuth - numbers[1][of, 6] * t))
    for j in np.unique(k):
        own = k == j
        numbers[0][j] = (
            np.median(np.arctan2(p[own, 2], np.hypot(p[own, 0], p[own, 1]))),
            np.angle(left[own].mean()),
        )
    for round_ in range(_ROUNDS):
        numbers, half = _improved(numbers, p, k, of, t)
        if round_ >= _ROUNDS // 2 and half > _HOPELESS:
            return None
    turning = Turning(*(part.astype(np.float32) for part in numbers))
    off = _off(numbers, points[sound], laser[sound], group[laser[sound]], time[sound])
    return turning, float(np.median(np.hypot(*off)))


def _rate(azimuth: F64, time: F64, laser: I64, lasers: int) -> float:
    """The turning rate at which the azimuths of each laser stand still."""
    rates = np.linspace(-_FASTEST, _FASTEST, _RATES)
    sharp = np.zeros(_RATES)
    for i, rate in enumerate(rates):
        phase = np.exp(1j * (azimuth - rate * time))
        sums = np.bincount(laser, phase.real, lasers) + 1j * np.bincount(laser, phase.imag, lasers)
        sharp[i] = np.abs(sums).sum()
    return float(rates[sharp.argmax()])


def _turned(v: F64, w: F64) -> F64:
    """Vectors ``(N, 3)`` turned by rotation vectors ``(N, 3)``."""
    angle = np.sqrt((w**2).sum(axis=1, keepdims=True)) + 1e-300
    axis = w / angle
    along = (axis * v).sum(axis=1, keepdims=True) * axis
    return np.asarray(along + np.cos(angle) * (v - along) + np.sin(angle) * np.cross(axis, v))


def _off(
    numbers: tuple[F64, F64, F64], p: F64, k: I64, of: I64, t: F64, local: F64 | None = None
) -> tuple[F64, F64]:
    """How far points are off their rays, up and aside, radians; ``local``: added to the 15 numbers that each point has."""
    own = np.concatenate([numbers[0][k], numbers[1][of], np.broadcast_to(numbers[2], (len(k), 6))], axis=1)
    if local is not None:
        own = own + local
    # Back to the sensor: what is left is the elevation and the azimuth of its own lasers.
    q = _turned(p - t[:, None] * own[:, 9:12], -t[:, None] * own[:, 12:15]) - own[:, 2:5]
    q = _turned(q, -own[:, 5:8])
    rho = np.hypot(q[:, 0], q[:, 1])
    up = np.arctan2(q[:, 2], rho) - own[:, 0]
    aside = np.arctan2(q[:, 1], q[:, 0]) - own[:, 1] - own[:, 8] * t
    aside = np.angle(np.exp(1j * aside)) * np.cos(own[:, 0])
    return up, aside


@njit(cache=True, error_model="numpy")
def _normal(change: F64, at: I64, off: F64, weight: F64, size: int) -> tuple[F64, F64]:
    """Normal equations ``(M, M)``, ``(M,)`` of the changes ``(2, J, N)`` of J numbers a point, which stand at ``at (J, N)``."""
    normal, right = np.zeros((size, size)), np.zeros(size)
    for way in range(2):
        for i in range(change.shape[2]):
            for j in range(change.shape[1]):
                own = change[way, j, i] * weight[way, i]
                right[at[j, i]] += own * off[way, i] * weight[way, i]
                for l in range(j + 1):
                    normal[at[j, i], at[l, i]] += own * change[way, l, i] * weight[way, i]
    for i in range(size):
        for j in range(i):
            normal[i, j] += normal[j, i]
            normal[j, i] = normal[i, j]
    return normal, right


def _improved(
    numbers: tuple[F64, F64, F64], p: F64, k: I64, of: I64, t: F64
) -> tuple[tuple[F64, F64, F64], float]:
    """One damped Gauss-Newton step on all numbers, points that are far off counting less; and what half were off by before it."""
    lasers, sensors = len(numbers[0]), len(numbers[1])
    ends = np.cumsum([_OF_LASER * lasers, _OF_SENSOR * sensors])
    off = np.stack(_off(numbers, p, k, of, t))
    change = np.empty((2, len(_STEPS), len(p)))
    at = np.empty((len(_STEPS), len(p)), np.int64)
    for j, step in enumerate(_STEPS):
        local = np.zeros(len(_STEPS))
        local[j] = step
        change[:, j] = (np.stack(_off(numbers, p, k, of, t, local)) - off) / step
        if j < _OF_LASER:
            at[j] = _OF_LASER * k + j
        elif j < _OF_LASER + _OF_SENSOR:
            at[j] = ends[0] + _OF_SENSOR * of + j - _OF_LASER
        else:
            at[j] = ends[1] + j - _OF_LASER - _OF_SENSOR
    half = np.median(np.abs(off), axis=1, keepdims=True)
    scale = 3.0 * half + 1e-9
    weight = 1.0 / np.sqrt(1.0 + (off / scale) ** 2) / scale
    normal, right = _normal(change, at, off, weight, int(ends[1]) + 6)
    normal[np.diag_indices_from(normal)] += _DAMPING * np.trace(normal) / len(normal)
    parts = np.split(-np.linalg.solve(normal, right), ends)
    better = tuple(old + new.reshape(old.shape) for old, new in zip(numbers, parts, strict=True))
    return better, float(half.sum())
