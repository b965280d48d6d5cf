"""A trajectory: poses with times, and the pose at any time between them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from salpcc.schemas.errors import SourceError

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

_NANO = 1e-9
_BESIDE = 0.01  # seconds that a scan may lie before the first pose or after the last, which is then its own
_GAP = 1.0  # seconds between two poses, over which nobody knows how one drove


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Where something was, and when.

    Attributes:
        name: of the file or topic, for messages.
        times: ``(n,)`` int64 nanoseconds, ascending, at least one.
        poses: ``(n, 4, 4)`` float64.
    """

    name: str
    times: I64
    poses: F64

    @classmethod
    def of(cls, name: str, times: Sequence[int] | I64, places: F64, quaternions: F64) -> Trajectory:
        """Make one of times ``(n,)``, places ``(n, 3)`` and quaternions ``(n, 4)`` x, y, z, w, in any order; of two at a time the first counts.

        Raises:
            SourceError: none; a number that is not finite, or a quaternion that is no rotation.
        """
        if not len(times):
            raise SourceError(f"{name}: no pose in it")
        length = np.linalg.norm(quaternions, axis=1)
        if not (np.isfinite(places).all() and np.isfinite(length).all() and (length > 0.5).all()):
            at = int(np.argmin(np.isfinite(places).all(axis=1) & np.isfinite(length) & (length > 0.5)))
            raise SourceError(
                f"{name}: pose {at + 1} is none (NaN, or a quaternion of length {length[at]:.3g})"
            )
        stamps, first = np.unique(np.asarray(times, np.int64), return_index=True)
        poses = np.tile(np.eye(4), (len(stamps), 1, 1))
        poses[:, :3, :3] = Rotation.from_quat(quaternions[first]).as_matrix()
        poses[:, :3, 3] = places[first]
        return cls(name, stamps, poses)

    def at(self, times: Sequence[int], names: Sequence[str]) -> F64:
        """Return the poses ``(k, 4, 4)`` at the times, nanoseconds, of scans: places along the line between two, turns along the arc.

        Raises:
            SourceError: a scan lies outside of the trajectory, or in a gap of it.
        """
        wanted = np.asarray(times, np.int64)
        seconds = (self.times - self.times[0]) * _NANO
        of = (wanted - self.times[0]) * _NANO
        self._refuse_uncovered(wanted, of, seconds, names)
        of = np.clip(of, seconds[0], seconds[-1])
        out = np.tile(np.eye(4), (len(of), 1, 1))
        for axis in range(3):
            out[:, axis, 3] = np.interp(of, seconds, self.poses[:, axis, 3])
        turns = Rotation.from_matrix(self.poses[:, :3, :3])
        out[:, :3, :3] = (
            Slerp(seconds, turns)(of) if len(seconds) > 1 else turns[np.zeros(len(of), int)]
        ).as_matrix()
        return out

    def _refuse_uncovered(self, wanted: I64, of: F64, seconds: F64, names: Sequence[str]) -> None:
        outside = (of < seconds[0] - _BESIDE) | (of > seconds[-1] + _BESIDE)
        if outside.any():
            at = int(np.argmax(outside))
            raise SourceError(
                f"{self.name}: poses from {_told(self.times[0])} to {_told(self.times[-1])} s, {outside.sum()} of {len(of)} scans "
                f"are not in between, such as {names[at]} at {_told(wanted[at])} s; name poses of the same drive and clock, "
                "cut the archive to their times, or use --poses odometry"
            )
        after = np.clip(np.searchsorted(seconds, of), 1, max(1, len(seconds) - 1))
        if len(seconds) == 1:
            return
        gap = seconds[after] - seconds[after - 1]
        far = (
            (gap > _GAP)
            & (np.abs(seconds[after] - of) > _BESIDE)
            & (np.abs(of - seconds[after - 1]) > _BESIDE)
        )
        if far.any():
            at = int(np.argmax(far))
            raise SourceError(
                f"{self.name}: scan {names[at]} at {_told(wanted[at])} s lies between poses {gap[at]:.1f} s apart, too far to tell "
                "how one drove in between; give denser poses, or use --poses odometry"
            )


def _told(time: int) -> str:
    return f"{int(time) // 10**9}.{int(time) % 10**9 // 10**6:03d}"
