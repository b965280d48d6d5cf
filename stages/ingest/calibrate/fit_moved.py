"""Scans that were moved by their points' times, undone: for a sensor whose model ships, or for one that is not known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from salpcc.stages.lattice.aim import aim
from salpcc.stages.lattice.find_lasers import Listed, find_lasers
from salpcc.stages.lattice.lattice import driven
from salpcc.stages.lattice.list_motion import fit_cones, redo, solve, undo
from salpcc.stages.lattice.sensor_model import SENSORS, SensorModel, load_sensor
from salpcc.stages.lattice.timed_motion import REFERENCES, find_timed_motion, onto_lattice, timed_places

_WORTH_IT = 0.5  # of the misfit of the cones, that undoing a motion leaves

_MORE = 1.3  # times the lasers that a cloud shows, that its sensor may have
_FLOATS = 2e-5  # metres that roundings may leave

F64 = NDArray[np.float64]


def undo_known(scans: Sequence[Listed], name: str) -> tuple[SensorModel, list[Listed]] | None:
    """Return the shipped model on whose lattice scans lie once their motion by time is undone, under a new name, and the scans so undone.

    Its share of identical bits is that of all returns, moved again. None where no shipped model is the sensor's.
    """
    for sensor in (load_sensor(file.stem) for file in sorted(SENSORS.glob("*.json"))):
        if sensor.driver is None or not all(may_be_of(sensor, scan.ring) for scan in scans):
            continue
        still, same, total = [], 0, 0
        for scan in scans:
            assert scan.time is not None
            points = scan.points.astype(np.float32)
            ring = None if scan.ring is None else scan.ring.astype(np.uint8)
            found = find_timed_motion(points, sensor, scan.time, ring)
            if found is None:
                break
            s = timed_places(scan.time, found[1])
            raw = undo(scan.points, s, found[0])
            laser, tick, count, off = aim(sensor, raw)
            if np.median(off) > _FLOATS:
                break
            still.append(replace(scan, points=raw, time=None))
            on = laser >= 0
            model = driven(
                sensor, laser[on].astype(np.uint8), tick[on].astype(np.int32), count[on].astype(np.float64)
            )
            back = redo(model, s[on], found[0]).astype(np.float32)
            same += int((back.view(np.int32) == points[on].view(np.int32)).all(axis=1).sum())
            total += int(scan.seen.sum())
        if len(still) == len(scans):
            return replace(sensor, name=name, bit_identical_share=round(same / max(total, 1), 6)), still
    return None


def may_be_of(sensor: SensorModel, ring: NDArray[np.int64] | None) -> bool:
    """Tell whether a sensor has about as many lasers as rings ``(N,)`` of a cloud show."""
    return ring is None or len(np.unique(ring)) <= sensor.n_lasers <= _MORE * len(np.unique(ring))


def undo_unknown(scans: Sequence[Listed]) -> tuple[list[Listed], list[tuple[F64, F64]]] | None:
    """Return scans whose motion by time is undone, and places and motion of each; None where cones say that there is none."""
    laser, _ = find_lasers(list(scans))
    lasers = 1 + max(int(k.max()) for k in laser)
    references: tuple[float, ...] = REFERENCES
    still: list[Listed] = []
    moves: list[tuple[F64, F64]] = []
    for scan, k in zip(scans, laser, strict=True):
        assert scan.time is not None
        seen = k >= 0
        least, best = _WORTH_IT * _misfit(scan.points[seen], k[seen], lasers), None
        for reference in references:
            s = timed_places(scan.time, reference)
            found = solve(scan.points, k, s, lasers)
            if found is None:
                continue
            raw = undo(scan.points, s, found.motion)
            misfit = _misfit(raw[seen], k[seen], lasers)
            if misfit < least:
                least, best = misfit, (raw, s, found.motion, reference)
        if best is None:
            return None
        raw, s, motion, reference = best
        references = (reference,)
        still.append(replace(scan, points=raw, time=None))
        moves.append((s, motion))
    return still, moves


def settle(sensor: SensorModel, scans: Sequence[Listed], moves: list[tuple[F64, F64]]) -> list[Listed]:
    """Undo the motions of scans anew, as the lattice of their fitted model says."""
    return [
        replace(
            scan,
            points=undo(
                scan.points, s, onto_lattice(sensor, scan.points[scan.seen], s[scan.seen], motion)[0]
            ),
            time=None,
        )
        for scan, (s, motion) in zip(scans, moves, strict=True)
    ]


def _misfit(points: F64, laser: NDArray[np.int64], lasers: int) -> float:
    return float(np.median(np.abs(fit_cones(points, laser, lasers)[1])))
