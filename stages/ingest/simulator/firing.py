"""Fire the lasers: which encoder ticks, from where, in which direction, and what the own car hides."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from salpcc.stages.lattice.sensor_model import SensorModel

F64 = NDArray[np.float64]

# What the car of SemanticKITTI hides: azimuth and half width in degrees, elevation below which
# nothing comes back. Read off the mean occupancy of 55 scans: roof behind, its two posts, bonnet,
# antenna mast, mounts.
_SHADOWS = ((180, 11, -18.9), (180, 24, -20.0), (180, 30, -22.9), (165, 5.5, -13.8), (-157, 5.5, -13.8), (0, 12, -21.6),
            (0, 19, -24.0), (-66, 10, -16.6), (-66, 6, -16.0), (-122, 4, -21.2), (133, 5, -21.2), (-31, 4, -23.2),
            (40, 3, -24.2))  # fmt: skip
# Brightness that each laser of KITTI's HDL-64E reports of the same surface, top laser first.
_HDL64_GAIN = (
    1.02, 0.92, 0.82, 0.78, 0.83, 0.88, 1.03, 0.93, 1.05, 0.82, 0.92, 1.03, 1.08, 0.97, 0.92, 0.84, 0.91, 0.93, 1.02, 0.85, 0.99, 0.67,
    0.96, 1.06, 0.86, 0.94, 0.99, 1.00, 1.00, 0.82, 1.09, 1.09, 1.05, 1.02, 1.11, 0.81, 0.64, 1.13, 1.35, 1.29, 1.07, 1.14, 0.77, 1.17,
    1.16, 1.16, 1.18, 1.07, 1.00, 1.26, 1.38, 0.54, 1.14, 0.97, 0.95, 1.16, 1.24, 1.37, 0.91, 0.93, 0.82, 1.19, 1.36, 1.28,
)  # fmt: skip
_SHADOW_DISTANCE = 0.9  # metres to what hides, for the parallax of the lever arm
_LEVER_DISTANCE = 12.0  # metres at which the azimuth of a point is foretold


@dataclass(frozen=True, eq=False)
class Shots:
    """The beams of one turn in sensor coordinates at the time of each: ``(L, F)`` arrays.

    ``s`` is the place in the turn that the motion compensation will give the point, in [-1/2, 1/2].
    """

    tick: NDArray[np.int64]
    origin: F64
    direction: F64
    s: F64


def firing_ticks(ticks_per_turn: int, rate: float, rng: np.random.Generator) -> NDArray[np.int64]:
    """Return the encoder ticks ``(F,)`` of a turn's firings.

    The lasers fire at a fixed interval and the encoder reports whole ticks: steps of 2, every
    sixth or seventh a 1. The seam of the turn lies behind the car.
    """
    start = float(rng.uniform(0, rate))
    steps = np.floor(start + rate * np.arange(int((ticks_per_turn - start) / rate))).astype(np.int64)
    return np.asarray((ticks_per_turn // 2 + steps) % ticks_per_turn)


def shots(sensor: SensorModel, ticks: NDArray[np.int64]) -> Shots:
    """Aim every laser at every firing (docs/sensor_lattice.md, section 1)."""
    turn = sensor.ticks_per_turn
    tick = (ticks[None, :] + sensor.shift[:, None]) % turn
    phi = tick * (2 * np.pi / turn) + sensor.phi0[:, None]
    theta, h = sensor.theta[:, None], sensor.h[:, None]
    cos, sin = np.cos(phi), np.sin(phi)
    origin = np.stack([-h * sin, h * cos, np.broadcast_to(sensor.z0[:, None], phi.shape)], -1)
    up = np.broadcast_to(np.sin(theta), phi.shape)
    direction = np.stack([np.cos(theta) * cos, np.cos(theta) * sin, up], -1)
    azimuth = phi + h / _LEVER_DISTANCE
    return Shots(tick, origin, direction, _wrap(azimuth) / (2 * np.pi))


def laser_gain(sensor: SensorModel) -> F64:
    """Return the brightness ``(L,)`` that each laser reports of the same surface: KITTI's, or drawn for others."""
    if sensor.n_lasers == len(_HDL64_GAIN):
        return np.array(_HDL64_GAIN)
    return np.asarray(
        np.random.default_rng(sensor.n_lasers).normal(1.0, 0.15, sensor.n_lasers).clip(0.5, 1.5)
    )


def hidden(sensor: SensorModel, tick: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return which shots ``(L, F)`` the own car stops."""
    phi = tick * (2 * np.pi / sensor.ticks_per_turn) + sensor.phi0[:, None]
    azimuth = np.degrees(phi + sensor.h[:, None] / _SHADOW_DISTANCE)
    elevation = np.degrees(sensor.theta)[:, None]
    out = np.zeros(phi.shape, bool)
    for centre, half, top in _SHADOWS:
        off = np.abs((azimuth - centre + 180) % 360 - 180)
        out |= (off < half) & (elevation < top)
    return out


def _wrap(angle: F64) -> F64:
    return np.asarray((angle + np.pi) % (2 * np.pi) - np.pi)
