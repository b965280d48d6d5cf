"""KITTI's ``.bin``: float32 x, y, z, intensity, 16 bytes a point, no header."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from salpcc.schemas.errors import SourceError
from salpcc.schemas.files import why
from salpcc.schemas.work import ScanRef

POINT_BYTES, RINGED_BYTES = 16, 20
NOMINAL_PERIOD_NS = 100_000_000  # the HDL-64E turns at 10 Hz; used where no time stamps were recorded


def read_points(path: Path) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Read points ``(N, 3)`` float32 in metres and intensity ``(N,)`` float32, bit for bit.

    Raises:
        SourceError: unreadable, or the size is not a multiple of 16 bytes.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise SourceError(f"{path}: {why(error)}") from error
    if len(data) % POINT_BYTES:
        raise SourceError(
            f"{path}: truncated, {len(data)} bytes is not a multiple of {POINT_BYTES}; fetch it again"
        )
    rows = np.frombuffer(data, "<f4").reshape(-1, 4)
    return np.ascontiguousarray(rows[:, :3]), np.ascontiguousarray(rows[:, 3])


def read_points_with_rings(
    path: Path,
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.int64] | None]:
    """Read nuScenes' ``.pcd.bin``, float32 x, y, z, intensity, ring: points, intensity, rings; None where the fifth number is no ring.

    Raises:
        SourceError: unreadable, or the size is not a multiple of 20 bytes.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise SourceError(f"{path}: {error.strerror or error}") from error
    if len(data) % RINGED_BYTES:
        raise SourceError(f"{path}: {len(data)} bytes is not a multiple of {RINGED_BYTES}; fetch it again")
    rows = np.frombuffer(data, "<f4").reshape(-1, 5)
    ring = rows[:, 4]
    with np.errstate(invalid="ignore"):
        sound = bool(((ring == np.rint(ring)) & (ring >= 0) & (ring < 4096)).all())
    return (
        np.ascontiguousarray(rows[:, :3]),
        np.ascontiguousarray(rows[:, 3]),
        ring.astype(np.int64) if sound else None,
    )


def points_to_bytes(points: NDArray[np.float32], intensity: NDArray[np.float32]) -> bytes:
    """Return the content of a ``.bin``; inverse of :func:`read_points`."""
    rows = np.empty((len(points), 4), "<u4")
    # Copied as integers, so that no bit of a NaN changes on the way.
    rows[:, :3] = np.ascontiguousarray(points, "<f4").view("<u4")
    rows[:, 3] = np.ascontiguousarray(intensity, "<f4").view("<u4")
    return rows.tobytes()


def list_scans(folder: Path, times: list[int] | None, labels: Path | None) -> list[ScanRef]:
    """List the ``.bin`` files of a folder.

    A stem of digits is the frame number; other names are numbered by their place in sorted order.

    Args:
        times: nanoseconds by frame number, or None for a nominal 10 Hz.
        labels: folder of ``.label`` files with the same stems, or None.
    """
    files = sorted(folder.glob("*.bin"))
    numeric = all(re.fullmatch(r"\d+", f.stem) for f in files)
    # One listing, for asking a store about each of them takes minutes.
    labelled = {file.name: str(file) for file in labels.glob("*.label")} if labels is not None else {}
    refs = []
    for place, file in enumerate(files):
        number = int(file.stem) if numeric else place
        time = times[number] if times is not None and number < len(times) else number * NOMINAL_PERIOD_NS
        refs.append(ScanRef(file.stem, number, str(file), time, labelled.get(f"{file.stem}.label")))
    return sorted(refs, key=lambda ref: (ref.number, ref.name))
