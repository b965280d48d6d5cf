"""Motion of clouds whose points tell their times: a point q became ``R(s w) q + s v`` as in :mod:`.list_motion`, but s follows from its time.

``s = reference - part``, part 0 at the first time of the cloud and 1 at its last. Drivers move clouds to their end, their beginning or their middle.
Found by cones, counts and ticks like a motion by place, it is then turned until points lie on the lattice as closely as floats allow.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from salpcc.stages.lattice.aim import aim, lies_on
from salpcc.stages.lattice.lattice import driven
from salpcc.stages.lattice.list_motion import F64, FASTEST, I64, follow, lock, put_on_cones, undo
from salpcc.stages.lattice.sensor_model import SensorModel

TimedMotion = tuple[F64, float]  # and its reference
REFERENCES = (1.0, 0.5, 0.0)
_ROUNDS = 3
_FEWEST_TIMES = 50
_SOLVED, _SAMPLE, _FEW = 24_000, 20_000, 1000  # points
_MOST_ALIASES = 64
_BETTER = 0.7  # times as far from the lattice, and a yaw is another
_CLOSER = 0.5  # of the distance from the lattice that a motion leaves
_ON_LATTICE = 0.002  # metres
_STILL = 1e-5  # metres from the lattice, of points that stand still


def timed_places(time: I64, reference: float) -> F64:
    """Return s of points at times ``(N,)``."""
    first, last = int(time.min()), int(time.max())
    return np.asarray(reference - (time - first) / float(max(last - first, 1)))


def find_timed_motion(
    points: NDArray[np.float32],
    sensor: SensorModel,
    time: I64,
    laser: NDArray[np.uint8] | None,
    like: TimedMotion | None = None,
) -> TimedMotion | None:
    """Return the motion ``(6,)`` and the reference that moved points ``(N, 3)`` of a known sensor off its lattice; None where there is none.

    Args:
        time: of each point ``(N,)``. ``laser``: of each, by whatever numbers; None: by the cone that is nearest.
        like: those of the scan before, from which it is followed where that leads onto the lattice.
    """
    if lies_on(sensor, points, _STILL) or len(np.unique(time[:: len(time) // 4096 + 1])) < _FEWEST_TIMES:
        return None
    with np.errstate(invalid="ignore"):
        seen = (np.abs(points) < 1e4).all(axis=1) & (np.abs(points).max(axis=1) > 0)
    wide = points[seen].astype(np.float64)
    number = aim(sensor, wide)[0] if laser is None else laser[seen].astype(np.int64)
    few = np.sort(np.random.default_rng(0).permutation(len(wide))[:_SOLVED])
    lasers = int(number.max(initial=0)) + 1
    if like is not None:
        s = timed_places(time, like[1])[seen]
        followed = follow(
            wide[few], number[few], s[few], lasers, like[0], sensor.ticks_per_turn, sensor.count
        )
        if followed is not None:
            followed, off = onto_lattice(sensor, wide, s, followed)
            if off < 0.5 * _STILL:
                return followed, like[1]
    best: tuple[float, F64, float] | None = None
    for reference in REFERENCES:
        s = timed_places(time, reference)[seen]
        on_cones = put_on_cones(wide[few], number[few], s[few], lasers)
        if on_cones is None or not on_cones.are_of(sensor):
            continue
        found = lock(on_cones, sensor.ticks_per_turn, sensor.count)
        if found is None:
            continue
        motion, off = onto_lattice(sensor, wide, s, _yawed(sensor, wide, s, found.motion))
        if best is None or off < best[0]:
            best = off, motion, reference
            if off < 0.5 * _STILL:  # no other reference is nearer
                break
    before = float(np.median(aim(sensor, wide[few])[3]))
    if best is None or best[0] > min(_CLOSER * before, _ON_LATTICE):
        return None
    return best[1], best[2]


def _yawed(sensor: SensorModel, points: F64, s: F64, motion: F64) -> F64:
    """The motion whose yaw puts points ``(N, 3)`` nearest to the lattice.

    Points of one time all turn alike, so a yaw of one tick more from time to time leaves ticks as whole; only the driver's roundings tell.
    """
    step = float(np.min(np.diff(np.unique(s)), initial=1.0))
    alias = 2.0 * np.pi / sensor.ticks_per_turn / step
    if sensor.driver is None or alias < FASTEST / _MOST_ALIASES:
        return motion
    few = np.random.default_rng(0).permutation(len(points))[:_FEW]
    most = int(FASTEST / alias) + 1
    yaws = motion[5] + alias * np.arange(-most, most + 1)
    best, nearest = motion, np.inf
    for yaw in yaws[np.argsort(np.abs(yaws), kind="stable")]:
        if abs(yaw) > FASTEST:
            continue
        tried, off = onto_lattice(sensor, points[few], s[few], np.append(motion[:5], yaw))
        if off < _BETTER * nearest:
            best, nearest = tried, off
    return best


def onto_lattice(sensor: SensorModel, points: F64, s: F64, motion: F64) -> tuple[F64, float]:
    """Adjust a motion ``(6,)`` until points ``(N, 3)`` at places ``(N,)`` are nearest to the lattice; return it and their median distance."""
    few = slice(None, None, len(points) // _SAMPLE + 1)
    points, s = points[few], s[few]
    for _ in range(_ROUNDS):
        raw = undo(points, s, motion)
        laser, tick, count, off = aim(sensor, raw)
        near = (laser >= 0) & (off <= 4.0 * np.median(off))
        model = driven(
            sensor, laser[near].astype(np.uint8), tick[near].astype(np.int32), count[near].astype(np.float64)
        )
        q, own = raw[near], s[near]
        # d raw / d v = -s, d raw / d w = -s w x raw.
        jacobian = np.zeros((len(q), 3, 6))
        for axis, (after, last) in enumerate(((1, 2), (2, 0), (0, 1))):
            jacobian[:, axis, axis] = -own
            jacobian[:, after, 3 + axis] = own * q[:, last]
            jacobian[:, last, 3 + axis] = -own * q[:, after]
        rows = jacobian.reshape(-1, 6)
        step = np.linalg.lstsq(rows.T @ rows, rows.T @ (q - model).ravel(), rcond=None)[0]
        motion = motion - step
    return motion, float(np.median(aim(sensor, undo(points, s, motion))[3]))
