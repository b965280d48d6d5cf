"""In which frame a scan's points are given: as they were recorded, or with the motion compensation undone or moved on.

A compensated point was ``P = R(s w) q + s v`` (:mod:`.untwist`): all points of a scan as seen from where the sensor was in the
middle of its turn, at ``s = 0``. KITTI's sensor turns clockwise, so a turn goes from ``s = 1/2`` to ``s = -1/2``.

    sensor   q, float32 of a whole number of millimetres: what the driver of the sensor wrote
    start    R(w / 2)^T (P - v / 2), rounded to float32: as seen from where the sensor was when the turn began
    end      R(-w / 2)^T (P + v / 2), when it ended
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal, get_args

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.schemas.errors import UsageError
from salpcc.schemas.scan import Scan
from salpcc.schemas.sweep import Sweep
from salpcc.stages.lattice.lattice import unproject
from salpcc.stages.lattice.publish import published_points, rounded
from salpcc.stages.lattice.sensor_model import SensorModel
from salpcc.stages.lattice.sweep import middle_counts, source_places, sweep_to_scan
from salpcc.stages.lattice.trig import TWO_PI, arctan2
from salpcc.stages.lattice.untwist import ON_LATTICE, inverse, moved, on_lattice, turned_back

Frame = Literal["recorded", "sensor", "start", "end"]
FRAMES: tuple[str, ...] = get_args(Frame)

_PART = {"start": 0.5, "end": -0.5}  # of a turn, s

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]


def sweep_in_frame(sweep: Sweep, sensor: SensorModel, frame: Frame, turn_ns: int, raw: bool = True) -> Scan:
    """Return the scan of a sweep in file order, its points in a frame; other than as recorded with when each was measured.

    Args:
        turn_ns: nanoseconds of a turn.
        raw: where no motion is known there was none to undo, and the points are what the sensor measured.

    Raises:
        UsageError: no motion of the scan is known, so it is in no frame but the recorded one.
    """
    scan = sweep_to_scan(sweep, sensor)
    if frame == "recorded":
        return scan
    motion = sweep.motion if raw else None
    if motion is None and not (raw and frame == "sensor"):
        raise UsageError("no motion of its turn is known, so it is in no frame but --frame recorded")
    on, off = source_places(sweep, sensor)
    points = scan.points.copy()
    if motion is not None:
        points[on] = _measured(sweep, sensor)
        points[off] = _solved(scan.points[off], motion)
    # Of returns the encoder's tick at their firing tells when, of strays their azimuth.
    ticks = sensor.ticks_per_turn
    firing = (sweep.tick.astype(np.int64) - sensor.shift[sweep.laser]) % ticks
    turn = np.empty(len(points))
    turn[on] = -(firing - ticks * (2 * firing > ticks)) / ticks
    turn[off] = _azimuth_turns(points[off])
    if frame in _PART and motion is not None:
        points = _moved_back(scan.points, _PART[frame], motion)
    return replace(scan, points=points, offset=np.rint(turn * turn_ns).astype(np.int32))


def _measured(sweep: Sweep, sensor: SensorModel) -> F32:
    """The returns ``(M, 3)`` in firing order as the sensor measured them. KITTI kept the sign of what it rounded to 0."""
    model = unproject(sensor, sweep.laser, sweep.tick, middle_counts(sweep))
    if sweep.max_error > 0:
        return model.astype(np.float32)
    points = published_points(rounded(model, sweep.millimetre, None))
    return np.where(points == 0, np.copysign(np.float32(0), model).astype(np.float32), points)


@njit(cache=True, error_model="numpy")
def _azimuth_turns(points: F32) -> F64:
    """When points ``(S, 3)`` were measured by their azimuth, in turns from the middle; 0 for what has none."""
    turn = np.empty(len(points))
    for i in range(len(points)):
        x, y = np.float64(points[i, 0]), np.float64(points[i, 1])
        turn[i] = -arctan2(y, x) / TWO_PI if abs(x) + abs(y) < np.inf else 0.0
    return turn


@njit(cache=True, error_model="numpy")
def _solved(points: F32, motion: F64) -> F32:
    """Solve for what the sensor measured of compensated points ``(S, 3)``: on its 1 mm lattice where that gives the point.

    A point whose y was rounded to 0 is among the strays for its sign: -0 is what a whole turn ends with, so that is tried
    before 0. What is not finite stays.
    """
    m = (motion[0], motion[1], motion[2], motion[3], motion[4], motion[5])
    raw = points.copy()
    for i in range(len(points)):
        x, y, z = np.float64(points[i, 0]), np.float64(points[i, 1]), np.float64(points[i, 2])
        if not (abs(x) + abs(y) + abs(z) < np.inf and abs(x) + abs(y) > 0.0):
            continue
        raw[i, 0], raw[i, 1], raw[i, 2] = inverse(x, y, z, motion, 0)
        found = False
        for branch in (0, 1, -1):
            qx, qy, qz = inverse(x, y, z, motion, branch)
            qx, qy, qz = on_lattice(qx), on_lattice(qy), on_lattice(qz)
            s = arctan2(qy, qx) / TWO_PI
            for sign in (-1.0, 1.0):
                zero = qy == 0.0
                part = sign * abs(s) if zero else s
                fx, fy, fz = moved(qx, qy, qz, part, m)
                if max(max(abs(fx - x), abs(fy - y)), abs(fz - z)) < ON_LATTICE and not found:
                    found = True
                    raw[i, 0], raw[i, 1], raw[i, 2] = qx, sign * 0.0 if zero else qy, qz
    return raw


@njit(cache=True, error_model="numpy")
def _moved_back(points: F32, s: float, motion: F64) -> F32:
    """Return points ``(N, 3)`` of the middle of a turn as seen from where the sensor was at ``s``."""
    m = (motion[0], motion[1], motion[2], motion[3], motion[4], motion[5])
    out = np.empty((len(points), 3), np.float32)
    for i in range(len(points)):
        x, y, z = np.float64(points[i, 0]), np.float64(points[i, 1]), np.float64(points[i, 2])
        out[i, 0], out[i, 1], out[i, 2] = turned_back(x, y, z, s, m)
    return out
