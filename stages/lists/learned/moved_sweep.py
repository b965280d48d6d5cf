"""The sweep before as a later one sees it: its returns moved by the motion of both, on the lattice of their sensor.

Clouds that tell their times and were moved by them (:mod:`~salpcc.stages.lists.aimed.moved_points`) have motions that a reader knows. Half of the way from one cloud to the
next is made at the pace of the one before, half at that of the later one; what stood still is then where the sensor sees it now.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from salpcc.stages.lattice.aim import aim
from salpcc.stages.lattice.lattice import unproject
from salpcc.stages.lattice.list_motion import redo
from salpcc.stages.lattice.sensor_model import SensorModel
from salpcc.stages.lattice.trig import TWO_PI
from salpcc.stages.lists.aimed.aimed_symbols import AIMED

_LATEST = 3.0  # spans from one cloud to the next; what is older says little
_ANEW = 0.5  # spans; clouds nearer than that count their times from their own beginning

I64 = NDArray[np.int64]
F64 = NDArray[np.float64]


class Clock(NamedTuple):
    """When a cloud's first point was measured, and how long the cloud took, in units of its times."""

    first: int
    span: int

    @classmethod
    def of(cls, time: I64) -> Clock:
        """Return that of points at times ``(N,)``."""
        first, last = int(time.min()), int(time.max())
        return cls(first, max(last - first, 1))


class Turn(NamedTuple):
    """The points ``(n,)`` of a sweep: azimuth in ticks, 1/d, the rings of :func:`~salpcc.stages.lists.aimed.aimed_neighbours.link`, and their places in the list where these are others."""

    azimuth: F64
    inverse: F64
    links: I64
    ends: I64
    places: I64


@dataclass(frozen=True, eq=False)
class Passing:
    """A sweep of a sensor in motion: kinds, lasers, ticks, counts ``(S,)`` as they become known, motion ``(6,)`` of its span, and its clock."""

    kinds: NDArray[np.uint8]
    laser: NDArray[np.uint8]
    tick: I64
    count: I64
    motion: F64
    clock: Clock


def no_turn() -> Turn:
    """Return what stands before the first sweep."""
    none = np.zeros((0, 2), np.int64)
    return Turn(np.zeros(0), np.zeros(0), none, none, np.zeros(0, np.int64))


def seen_later(before: Passing | None, own: Passing | None, sensor: SensorModel) -> Turn:
    """Return the returns of the sweep before where the sensor sees them in the course of ``own``; nothing where one of them is not known, or they lie far apart."""
    if before is None or own is None:
        return no_turn()
    ahead = (own.clock.first - before.clock.first) / before.clock.span
    if abs(ahead) < _ANEW:
        ahead = 1.0
    if abs(ahead) > _LATEST:
        return no_turn()
    on = np.flatnonzero(before.kinds == AIMED)
    tick = (before.tick[on] % sensor.ticks_per_turn).astype(np.int32)
    points = unproject(sensor, before.laser[on], tick, before.count[on].astype(np.float64))
    half = np.full(len(on), 0.5 * ahead)
    points = redo(points, half, before.motion)
    points = redo(points, half * (before.clock.span / own.clock.span), own.motion)
    laser, tick_now, count, _ = aim(sensor, points)
    seen = laser >= 0
    return _turn_of(sensor, laser[seen], tick_now[seen], count[seen], on[seen])


def _turn_of(sensor: SensorModel, laser: I64, tick: I64, count: I64, places: I64) -> Turn:
    """Return points ``(n,)`` on the lattice in the order of lasers, those of one in that of azimuths."""
    parameters = sensor.parameters
    azimuth = tick + parameters[laser, 3] * (sensor.ticks_per_turn / TWO_PI)
    inverse = 1.0 / np.maximum(count * sensor.count + parameters[laser, 4], 1e-3)
    return turn_of(laser, azimuth, inverse, places, sensor.n_lasers)


def turn_of(laser: I64, azimuth: F64, inverse: F64, places: I64, lasers: int) -> Turn:
    """Return points ``(n,)`` in the order of lasers, those of one in that of azimuths."""
    order = np.lexsort((azimuth, laser))
    laser, azimuth, inverse = laser[order], azimuth[order], inverse[order]
    every = np.arange(lasers)
    first = np.searchsorted(laser, every)
    last = np.searchsorted(laser, every, side="right") - 1
    links = np.arange(len(laser))[:, None] + np.array([-1, 1])
    some = first <= last
    links[first[some], 0], links[last[some], 1] = last[some], first[some]
    ends = np.where(some[:, None], np.stack([first, last], axis=1), -1)
    return Turn(azimuth, inverse, links, ends, places[order])
