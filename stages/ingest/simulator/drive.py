"""Lay the centre line of the street and drive along it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from salpcc.stages.ingest.simulator.config import SimulationConfig

F64 = NDArray[np.float64]
Lengths = NDArray[np.float64] | np.float64
_STEP = 0.25  # metres between nodes of the centre line
MARGIN = 110.0  # metres of street before the start and after the end of the drive


@dataclass(frozen=True, eq=False)
class CentreLine:
    """The street's axis as dense nodes by length ``s``: position, heading, height."""

    s: F64
    xy: F64
    heading: F64
    height: F64

    def place(self, s: Lengths, left: Lengths) -> F64:
        """Return the points ``(..., 3)`` at ``left`` metres beside length ``s``, on the axis' height."""
        x, y = (np.interp(s, self.s, self.xy[:, i]) for i in (0, 1))
        h = self.angle(s)
        return np.stack([x - left * np.sin(h), y + left * np.cos(h), np.interp(s, self.s, self.height)], -1)

    def angle(self, s: Lengths) -> F64:
        """Return the heading at length ``s`` in rad."""
        return np.asarray(np.interp(s, self.s, self.heading))

    def slope(self, s: Lengths) -> F64:
        """Return the rise per metre at length ``s``."""
        return np.asarray((np.interp(s + 1, self.s, self.height) - np.interp(s - 1, self.s, self.height)) / 2)


@dataclass(frozen=True, eq=False)
class Drive:
    """The vehicle's way along the street."""

    config: SimulationConfig
    line: CentreLine
    lane: float
    phases: F64

    def length(self, t: NDArray[np.float64] | float) -> F64:
        """Return the length driven until ``t`` seconds (0 is the first scan)."""
        c = self.config
        rate = 2 * np.pi / c.speed_period_s
        wave = (np.cos(self.phases[0]) - np.cos(rate * np.asarray(t) + self.phases[0])) / rate
        return np.asarray(c.speed_mps * (np.asarray(t) + c.speed_wave * wave))

    def pose(self, t: float) -> tuple[F64, F64]:
        """Return rotation ``(3, 3)`` and position ``(3,)`` of the sensor in the world at time ``t``."""
        s = self.length(t)
        weave = 0.15 * np.sin(s / 31.0 + self.phases[1])
        position = self.line.place(s, self.lane + weave) + (0, 0, self.config.sensor_height)
        yaw = float(self.line.angle(s)) + 0.15 / 31.0 * np.cos(s / 31.0 + self.phases[1])
        bounce = min(self.config.speed_mps / 8.0, 1.0)
        pitch = -np.arctan(float(self.line.slope(s))) + 0.004 * bounce * np.sin(7.0 * t + self.phases[2])
        roll = 0.005 * bounce * np.sin(5.1 * t + self.phases[3])
        return Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix(), position

    def motion(self, t: float) -> F64:
        """Return ``(v, w)`` of the turn around ``t``: what section 2 of docs/sensor_lattice.md compensates.

        The sensor turns clockwise, so that time falls as azimuth rises: the signs are those of the
        motion backwards.
        """
        half = self.config.period_s / 2
        (ra, pa), (rb, pb), (r, _) = self.pose(t - half), self.pose(t + half), self.pose(t)
        turn = Rotation.from_matrix(ra.T @ rb).as_rotvec()
        return np.concatenate([-(r.T @ (pb - pa)), -turn])


def lay(config: SimulationConfig, lane: float) -> Drive:
    """Lay the centre line for a drive that keeps ``lane`` metres left of it."""
    rng = np.random.default_rng((config.seed, 1))
    phases = rng.uniform(0, 2 * np.pi, 16)
    reach = config.scans * config.period_s * config.speed_mps * (1 + config.speed_wave) + MARGIN
    s = np.arange(-MARGIN, reach + _STEP, _STEP)
    heading = np.zeros_like(s)
    for i, (wave, amplitude) in enumerate(config.yaw):
        heading += amplitude * np.sin(2 * np.pi * s / wave + phases[4 + i % 6])
    steps = np.stack([np.cos(heading), np.sin(heading)], 1) * _STEP
    xy = np.concatenate([np.zeros((1, 2)), np.cumsum(steps[:-1], axis=0)])
    height = 1.6 * np.sin(2 * np.pi * s / 310 + phases[10]) + 0.25 * np.sin(2 * np.pi * s / 71 + phases[11])
    return Drive(config, CentreLine(s, xy, heading, height), lane, phases[:4])
