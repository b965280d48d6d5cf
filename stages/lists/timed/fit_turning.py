"""Find the rays of :mod:`.turning_rays` that points lie on: a writer's part, which no reader repeats."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.lists.timed.turning_rays import Turning

_FASTEST, _RATES = 8.0, 321  # radians from the first to the last point; tried
_SAMPLE, _FEW = 12_000, 2000  # points; of these in all rounds but the last
_FEWEST_ROUNDS, _ROUNDS = 4, 14
_GAIN = 0.97  # times as far up as before the round before; else the last round follows
# What it counts that points are aside: readers learn how the turning strays, but not how elevations do.
_ASIDE = 0.3
_AS_GOOD = 1.2  # times as far off as the points of the scan before were, from the rays of which rounds began
_HOPELESS = 0.02  # radians that half of the points are off by
_DAMPING = 1e-6
_STEPS = np.array([1e-5, 1e-5, 1e-3, 1e-3, 1e-3, 1e-5, 1e-5, 1e-5, 1e-5, 1e-3, 1e-3, 1e-3, 1e-5, 1e-5, 1e-5])
_OF_LASER, _OF_SENSOR = 2, 7
_NUMBERS, _RATE = len(_STEPS), _OF_LASER + 6  # of each point; which of these is how fast its sensor turns
_FEWEST_POINTS = 1500

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
Numbers = tuple[F64, F64, F64]  # of lasers, of sensors, the motion
Fitted = tuple[Turning, float]  # and how far off half of the points are, radians

_TURN = 2.0 * np.pi


def fit_turning(points: F64, laser: I64, group: I64, time: F64) -> Fitted | None:
    """Return the rays of points ``(N, 3)`` of lasers ``(N,)`` at times ``(N,)`` (-1/2 to 1/2), and how far off half of them are, radians.

    Args:
        group: the sensor of every laser that may be.
    """
    lasers, sensors = int(laser.max()) + 1, int(group[laser].max()) + 1
    sound = _sound(points)
    if len(sound) < _FEWEST_POINTS:
        return None
    p, k, of, t = _sample(sound, points, laser, group, time)
    azimuth = np.arctan2(p[:, 1], p[:, 0])
    numbers = np.zeros((lasers, _OF_LASER)), np.zeros((sensors, _OF_SENSOR)), np.zeros(6)
    few = [np.flatnonzero(of[:_FEW] == g) for g in range(sensors)]
    numbers[1][:, 6] = [_rate(azimuth[own], t[own], k[own], lasers) for own in few]
    left = np.exp(1j * (azimuth - numbers[1][of, 6] * t))
    for j in np.unique(k):
        own = k == j
        numbers[0][j] = (
            np.median(np.arctan2(p[own, 2], np.hypot(p[own, 0], p[own, 1]))),
            np.angle(left[own].mean()),
        )
    numbers, half = _fitted(numbers, p, k, of, t)
    return None if half > _HOPELESS else _measured(numbers, p, k, of, t)


def fit_again(points: F64, laser: I64, group: I64, time: F64, before: Fitted) -> Fitted | None:
    """Fit the rays of the scan before to points given as for :func:`fit_turning`; None where they are of other lasers, or turn otherwise."""
    turning, off = before
    lasers, sensors = int(laser.max()) + 1, int(group[laser].max()) + 1
    sound = _sound(points)
    if len(sound) < _FEWEST_POINTS or (len(turning.lasers), len(turning.sensors)) != (lasers, sensors):
        return None
    sample = _sample(sound, points, laser, group, time)
    wide = turning.lasers.astype(np.float64), turning.sensors.astype(np.float64)
    numbers = *wide, turning.motion.astype(np.float64)
    again = _measured(_fitted(numbers, *sample)[0], *sample)
    return again if again[1] < _AS_GOOD * off else None


def _sound(points: F64) -> I64:
    """Points ``(N, 3)`` that are returns."""
    reach = np.sqrt((points**2).sum(axis=1))
    return np.flatnonzero(np.isfinite(reach) & (reach > 0.5) & (reach < 1e4))


def _sample(sound: I64, points: F64, laser: I64, group: I64, time: F64) -> tuple[F64, I64, I64, F64]:
    """Some of the points, their lasers, sensors and times."""
    some = np.random.default_rng(0).permutation(sound)[:_SAMPLE]
    return points[some], laser[some], group[laser[some]], time[some]


def _fitted(numbers: Numbers, *sample: Any) -> tuple[Numbers, float]:
    """Numbers that rounds over a few points have improved for as long as elevations gained, then one over all; and how far off half of these were before it, radians."""
    before, few = np.inf, [part[:_FEW] for part in sample]
    for made in range(_ROUNDS):
        numbers, (up, _) = _improved(numbers, *few)
        if made >= _FEWEST_ROUNDS and up > _GAIN * before:
            break
        before = up
    numbers, half = _improved(numbers, *sample)
    return numbers, sum(half)


def _measured(numbers: Numbers, *sample: Any) -> Fitted:
    off, _ = _off(*numbers, *sample, _STEPS[:0])
    return Turning(*(part.astype(np.float32) for part in numbers)), float(np.median(np.hypot(*off)))


def _rate(azimuth: F64, time: F64, laser: I64, lasers: int) -> float:
    """The turning rate at which the azimuths of each laser stand still."""
    rates, step = np.linspace(-_FASTEST, _FASTEST, _RATES, retstep=True)
    sharp = np.zeros(_RATES)
    phase, on = np.exp(1j * (azimuth - rates[0] * time)), np.exp(-1j * step * time)
    for i in range(_RATES):
        sums = np.bincount(laser, phase.real, lasers) + 1j * np.bincount(laser, phase.imag, lasers)
        sharp[i] = np.abs(sums).sum()
        phase *= on
    return float(rates[sharp.argmax()])


@njit(cache=True, error_model="numpy")
def _turned(x: float, y: float, z: float, a: float, b: float, c: float) -> tuple[float, float, float]:
    """A vector turned by the rotation vector (a, b, c)."""
    angle = np.sqrt(a * a + b * b + c * c) + 1e-300
    a, b, c = a / angle, b / angle, c / angle
    sine, cosine = np.sin(angle), np.cos(angle)
    along = (a * x + b * y + c * z) * (1.0 - cosine)
    return (
        along * a + cosine * x + sine * (b * z - c * y),
        along * b + cosine * y + sine * (c * x - a * z),
        along * c + cosine * z + sine * (a * y - b * x),
    )


@njit(cache=True, error_model="numpy")
def _undone(p: F64, s: float, motion: F64, change: F64) -> tuple[float, float, float]:
    """A point ``(3,)`` where the vehicle saw it."""
    return _turned(
        p[0] - s * (motion[0] + change[9]), p[1] - s * (motion[1] + change[10]),
        p[2] - s * (motion[2] + change[11]),
        -s * (motion[3] + change[12]), -s * (motion[4] + change[13]), -s * (motion[5] + change[14]),
    )  # fmt: skip


@njit(cache=True, error_model="numpy")
def _seen(x: float, y: float, z: float, sensor: F64, change: F64) -> tuple[float, float]:
    """Elevation and azimuth from a sensor."""
    x, y, z = _turned(
        x - sensor[0] - change[2], y - sensor[1] - change[3], z - sensor[2] - change[4],
        -sensor[3] - change[5], -sensor[4] - change[6], -sensor[5] - change[7],
    )  # fmt: skip
    return np.arctan2(z, np.sqrt(x * x + y * y)), np.arctan2(y, x)


@njit(cache=True, error_model="numpy")
def _aside(up: float, azimuth: float, s: float, laser: F64, sensor: F64, change: F64) -> tuple[float, float]:
    """How far elevation and azimuth are from those of a laser: up and aside, radians."""
    elevation = laser[0] + change[0]
    aside = azimuth - laser[1] - change[1] - (sensor[6] + change[8]) * s
    return up - elevation, (aside - _TURN * np.rint(aside / _TURN)) * np.cos(elevation)


@njit(cache=True, error_model="numpy")
def _off(
    of_laser: F64, of_sensor: F64, motion: F64, p: F64, k: I64, of: I64, t: F64, steps: F64
) -> tuple[F64, F64]:
    """How far points are off their rays, ``(2, N)``: up and aside, radians; and by how much more per change of the J numbers that each has, ``(2, J, N)``.

    ``steps``: by which these are changed ``(J,)``; none ``(0,)``: changes are not asked for.
    """
    off, more = np.empty((2, len(p))), np.empty((2, len(steps), len(p)))
    change = np.zeros(_NUMBERS)
    for i in range(len(p)):
        s, laser, sensor = t[i], of_laser[k[i]], of_sensor[of[i]]
        x, y, z = _undone(p[i], s, motion, change)
        up, azimuth = _seen(x, y, z, sensor, change)
        off[0, i], off[1, i] = _aside(up, azimuth, s, laser, sensor, change)
        for j in range(len(steps)):
            change[j] = steps[j]
            a, b, c = x, y, z
            other_up, other_azimuth = up, azimuth
            if j >= _OF_LASER + _OF_SENSOR:
                a, b, c = _undone(p[i], s, motion, change)
            if j >= _OF_LASER and j != _RATE:
                other_up, other_azimuth = _seen(a, b, c, sensor, change)
            other = _aside(other_up, other_azimuth, s, laser, sensor, change)
            more[0, j, i] = (other[0] - off[0, i]) / steps[j]
            more[1, j, i] = (other[1] - off[1, i]) / steps[j]
            change[j] = 0.0
    return off, more


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


def _improved(numbers: Numbers, p: F64, k: I64, of: I64, t: F64) -> tuple[Numbers, tuple[float, float]]:
    """One damped Gauss-Newton step on all numbers, points that are far off counting less; and what half were off by before it, up and aside."""
    lasers, sensors = len(numbers[0]), len(numbers[1])
    ends = np.cumsum([_OF_LASER * lasers, _OF_SENSOR * sensors])
    off, change = _off(*numbers, p, k, of, t, _STEPS)
    at = np.empty((_NUMBERS, len(p)), np.int64)
    for j in range(_NUMBERS):
        if j < _OF_LASER:
            at[j] = _OF_LASER * k + j
        elif j < _OF_LASER + _OF_SENSOR:
            at[j] = ends[0] + _OF_SENSOR * of + j - _OF_LASER
        else:
            at[j] = ends[1] + j - _OF_LASER - _OF_SENSOR
    half = np.median(np.abs(off), axis=1, keepdims=True)
    scale = 3.0 * half + 1e-9
    weight = 1.0 / np.sqrt(1.0 + (off / scale) ** 2) / scale
    weight[1] *= _ASIDE
    normal, right = _normal(change, at, off, weight, int(ends[1]) + 6)
    normal[np.diag_indices_from(normal)] += _DAMPING * np.trace(normal) / len(normal)
    first, second, third = np.split(-_solved(normal, right, int(ends[0])), ends)
    of_laser, of_sensor, motion = numbers
    better = (
        of_laser + first.reshape(-1, _OF_LASER),
        of_sensor + second.reshape(-1, _OF_SENSOR),
        motion + third,
    )
    return better, (float(half[0, 0]), float(half[1, 0]))


def _solved(normal: F64, right: F64, n: int) -> F64:
    """Solve normal equations whose first ``n`` numbers, two of each laser, meet only those of the same laser and the others."""
    blocks = np.array([normal[i : i + _OF_LASER, i : i + _OF_LASER] for i in range(0, n, _OF_LASER)])
    border = normal[:n, n:].reshape(len(blocks), _OF_LASER, -1)
    known = np.linalg.solve(blocks, np.concatenate([border, right[:n].reshape(-1, _OF_LASER, 1)], axis=2))
    by_border, by_right = known[:, :, :-1].reshape(n, -1), known[:, :, -1].reshape(n)
    others = np.linalg.solve(
        normal[n:, n:] - normal[n:, :n] @ by_border, right[n:] - normal[n:, :n] @ by_right
    )
    return np.concatenate([by_right - by_border @ others, others])
