"""De-skew: a scan takes a turn; move each of its returns to where it would be seen from at one instant.

A raw point ``q`` that was fired ``s`` turns before the instant goes to ``R(s w) q + s v``, KITTI's own formula
(docs/sensor_lattice.md, section 2), with ``(v, w)`` of the trajectory. The instant is that of the scan's pose: where points
have times, the message's stamp; else when the sensor looked ahead, as KITTI's cameras were triggered. Scans that were
compensated already have a motion of their own and are left alone.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from salpcc.schemas.scan import Scan
from salpcc.stages.lattice.list_motion import redo
from salpcc.stages.mapping.drive.poses import inverse

F64 = NDArray[np.float64]

# What drivers call the time of a point: in whole nanoseconds, or in seconds.
_TIME_FIELDS = ("t", "time", "timestamp", "time_stamp", "offset_time", "timeoffset")
_NANO = 1e-9
_LONGEST = 1.0  # seconds of a turn, and from the stamp to its points; what is longer is of another clock
_FARTHEST = 3  # turns to a neighbour whose pose still tells how fast this scan was


def turns_before(scan: Scan) -> F64:
    """Return by how many turns each point ``(N,)`` was fired before the scan's instant; zeros for a compensated scan."""
    if scan.motion is not None:
        return np.zeros(len(scan))
    timed = _by_times(scan)
    if timed is not None:
        return timed
    x, y = scan.points[:, 0].astype(np.float64), scan.points[:, 1].astype(np.float64)
    with np.errstate(invalid="ignore"):
        turned = np.arctan2(y, x) / (2.0 * np.pi)  # these sensors turn clockwise, and are cut behind
    return np.where(np.isfinite(turned), turned, 0.0)


def deskewed(points: NDArray[np.floating], before: F64, motion: F64) -> F64:
    """Move points ``(N, 3)`` to the instant of their pose, by ``before`` ``(N,)`` and the motion ``(6,)`` per turn."""
    return np.asarray(redo(points.astype(np.float64), before, motion))


def motions_of(poses: F64, numbers: Sequence[int]) -> F64:
    """Return the motion ``(n, 6)`` per turn of each scan of a trajectory ``(n, 4, 4)``, from its poses before and after.

    ``numbers`` count turns. Zeros where no neighbour is near enough in time.
    """
    n = len(poses)
    steps = np.zeros((n, 6))
    known = np.zeros(n, np.bool_)
    for k in range(1, n):
        turns = numbers[k] - numbers[k - 1]
        if 0 < turns <= _FARTHEST:
            steps[k], known[k] = motion_of(inverse(poses[k - 1]) @ poses[k], turns), True
    out = np.zeros((n, 6))
    for k in range(n):
        near = [i for i in (k, k + 1) if i < n and known[i]]
        if near:
            out[k] = steps[near].mean(axis=0)
    return out


def fastest(motions: F64, length: int) -> slice:
    """Choose the stretch of ``length`` scans, or all if there are fewer, on which one drove farthest, by motions ``(n, 6)``."""
    speed = np.linalg.norm(motions[:, :3], axis=1)
    ways = [speed[at : at + length].sum() for at in range(max(1, len(speed) - length + 1))]
    at = int(np.argmax(ways))
    return slice(at, min(at + length, len(speed)))


def motion_of(step: F64, turns: float) -> F64:
    """Return the motion ``(6,)`` per turn that takes a pose ``step`` on in ``turns``; inverse of :func:`step_of`.

    It counts by the azimuth, against which the sensor turns; hence the signs.
    """
    turn = Rotation.from_matrix(step[:3, :3]).as_rotvec()
    return np.concatenate([step[:3, 3], turn]) / -turns


def step_of(motion: F64, turns: float) -> F64:
    """Return the pose of a scan ``turns`` turns on, in the frame of the scan before, by its motion ``(6,)``."""
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_rotvec(-turns * motion[3:]).as_matrix()
    pose[:3, 3] = -turns * motion[:3]
    return pose


def _by_times(scan: Scan) -> F64 | None:
    """The same by the times that a log's points have; None where they have none that make a turn."""
    if scan.cloud is None or not len(scan):
        return None
    layout = scan.cloud.layout
    inside = [c for c in layout.columns if c.name.lower() in _TIME_FIELDS]
    if not inside:
        return None
    values = scan.cloud.values(inside[0])
    seconds = values.astype(np.float64) * (_NANO if values.dtype.kind in "iu" else 1.0)
    if not np.isfinite(seconds).all():
        return None
    first, last = float(seconds.min()), float(seconds.max())
    if not 0.0 < last - first < _LONGEST:
        return None
    stamp = layout.stamp * _NANO
    instant = stamp if abs(first - stamp) < _LONGEST else 0.0 if abs(first) < _LONGEST else first
    return np.asarray((instant - seconds) / (last - first))
