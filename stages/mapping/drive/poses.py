"""Poses of a drive: read KITTI's ``poses.txt``, pick those of an archive's scans, move points by them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from salpcc.schemas.errors import SourceError
from salpcc.stages.ingest.sources.frame_lines import frame_lines
from salpcc.stages.residual_code.archive.format import frame_number

F64 = NDArray[np.float64]

# Printed with six digits, real rotations are off by 1e-6; what is off by more is no rotation.
_ROTATION_SLACK = 1e-3


def read_poses(path: Path) -> F64:
    """Read sensor poses ``(N, 4, 4)`` from KITTI's camera poses and the ``calib.txt`` beside them.

    KITTI gives, per frame, the left camera in the first one's frame; ``Tr`` takes the sensor to the camera. The
    result has the sensor in its own first frame: x ahead, y left, z up. A line that is not a pose, blank or
    with a NaN, gives a pose of NaN: it matters only to who wants that frame.

    Raises:
        SourceError: a file is missing or unreadable, a line has not 12 numbers, no ``Tr``.
    """
    if not path.is_file():
        raise SourceError(f"{path}: no poses there; name a KITTI poses.txt, or use --poses odometry")
    camera = _matrices(path)
    to_camera = _calibration(path.with_name("calib.txt"))
    return _sound(np.linalg.inv(to_camera) @ camera @ to_camera)


def read_sensor_poses(path: Path) -> F64:
    """Read poses ``(N, 4, 4)`` that are the sensor's, in lines as KITTI's, as a map has them.

    Raises:
        SourceError: the file is unreadable, a line has not 12 numbers.
    """
    return _sound(_matrices(path))


def _matrices(path: Path) -> F64:
    none = np.full((4, 4), np.nan)
    rows = enumerate(frame_lines(path))
    poses = [_matrix(row, f"{path}: line {at + 1}") if row else none for at, row in rows]
    if not poses:
        raise SourceError(f"{path}: no pose in it; use --poses odometry")
    return np.array(poses)


def _sound(sensor: F64) -> F64:
    """Return poses ``(N, 4, 4)`` with NaN in place of what is no rotation."""
    square = np.einsum("nij,nkj->nik", sensor[:, :3, :3], sensor[:, :3, :3])
    with np.errstate(invalid="ignore"):
        sound = np.abs(square - np.eye(3)).max(axis=(1, 2)) < _ROTATION_SLACK
    sensor[~sound] = np.nan
    return sensor


def poses_of(names: Sequence[str], poses: F64, path: Path) -> F64:
    """Pick the poses ``(len(names), 4, 4)`` of scans; the line number of a pose is its frame number.

    Raises:
        SourceError: there is no pose for a scan, or it is no pose.
    """
    numbers = [frame_number(name, place) for place, name in enumerate(names)]
    for name, number in zip(names, numbers, strict=True):
        if number >= len(poses):
            raise SourceError(
                f"{path}: {len(poses)} poses, none for scan {name}; name the poses of its sequence, "
                "or use --poses odometry"
            )
        if not np.isfinite(poses[number]).all():
            raise SourceError(
                f"{path}: line {number + 1}, the pose of scan {name}, is not a pose (NaN, or no rotation); "
                "mend it, or use --poses odometry"
            )
    return poses[numbers]


def move(points: NDArray[np.floating], pose: F64) -> F64:
    """Take points ``(N, 3)`` through a pose, in float64."""
    return np.asarray(points.astype(np.float64) @ pose[:3, :3].T + pose[:3, 3])


def inverse(pose: F64) -> F64:
    """Return the pose ``(4, 4)`` that undoes ``pose``."""
    out = np.eye(4)
    out[:3, :3] = pose[:3, :3].T
    out[:3, 3] = -pose[:3, :3].T @ pose[:3, 3]
    return out


def proper(pose: F64) -> F64:
    """Return the pose ``(4, 4)`` nearest to a matrix whose rotation is off by rounding: in a long chain that grows."""
    out = pose.copy()
    left, _, right = np.linalg.svd(pose[:3, :3])
    out[:3, :3] = left @ right
    return out


def _calibration(path: Path) -> F64:
    if not path.is_file():
        raise SourceError(f"{path}: not found; it must stand beside the poses and have a line `Tr:`")
    for row in frame_lines(path):
        if row.startswith("Tr:"):
            matrix = _matrix(row[3:], f"{path}: Tr")
            if not np.isfinite(matrix).all() or abs(np.linalg.det(matrix[:3, :3]) - 1) > _ROTATION_SLACK:
                raise SourceError(f"{path}: its line `Tr:` is not a pose; take the calib.txt of this drive")
            return matrix
    raise SourceError(f"{path}: no line `Tr:`, which takes the sensor to the camera")


def _matrix(row: str, where: str) -> F64:
    try:
        values = [float(value) for value in row.split()]
    except ValueError as error:
        raise SourceError(f"{where}: {error}") from error
    if len(values) != 12:
        raise SourceError(f"{where}: {len(values)} numbers, a pose has 12; mend it")
    return np.concatenate([np.array(values).reshape(3, 4), [[0.0, 0.0, 0.0, 1.0]]])
