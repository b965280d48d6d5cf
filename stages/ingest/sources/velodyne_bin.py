"""KITTI's ``.bin``: float32 x, y, z, intensity, 16 bytes a point, no header; others' have a fifth number."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from salpcc.schemas.cloud_layout import CDR
from salpcc.schemas.errors import SourceError
from salpcc.schemas.files import location, why
from salpcc.schemas.log import LogMessage
from salpcc.schemas.messages import XYZI, CloudMessage
from salpcc.schemas.scan import Scan
from salpcc.schemas.work import ScanRef
from salpcc.stages.ingest.point_cloud import message_to_scan

NOMINAL_PERIOD_NS = 100_000_000  # the HDL-64E turns at 10 Hz; used where no time stamps were recorded
_FEWEST_TO_TELL = 16  # rows, below which their values say little


def read_scan(ref: ScanRef) -> Scan:
    """Read the scan of a ``.bin`` file, bit for bit. A fifth column becomes a field of a cloud, as a log's ring or time is one.

    Raises:
        SourceError: unreadable, not whole rows, or rows of another length than ``ref.columns``.
    """
    path = location(ref.path)
    rows = read_rows(path, ref.columns)
    if ref.columns == 4:
        if looks_wide(rows):
            raise SourceError(
                f"{path}: every fifth number is a ring or a time, so these are rows of five: --columns 5"
            )
        return Scan(ref.name, *_split(rows), ref.time)
    name = "ring" if _rings(rows[:, 4]) is not None else "column_5"
    message = CloudMessage(
        ref.time, "", len(rows), rows.tobytes(), point_step=20, fields=(*XYZI, (name, 16, 7, 1))
    )
    logged = LogMessage(1, ref.time, ref.time, 0, message.to_cdr())
    return message_to_scan(logged, CDR, "", ref.name)


def read_rows(path: Path, columns: int) -> NDArray[np.float32]:
    """Read the rows ``(N, columns)`` float32 of a file: x, y, z in metres, intensity, and more.

    Raises:
        SourceError: unreadable, or the size is not a multiple of a row's.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise SourceError(f"{path}: {why(error)}") from error
    if len(data) % (4 * columns):
        other = 9 - columns
        hint = f"; rows of {other}? then --columns {other}" if len(data) % (4 * other) == 0 else ""
        raise SourceError(
            f"{path}: truncated, {len(data)} bytes is not a multiple of {4 * columns}{hint or '; fetch it again'}"
        )
    return np.frombuffer(data, "<f4").reshape(-1, columns)


def read_points(path: Path) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Read points ``(N, 3)`` float32 in metres and intensity ``(N,)`` float32, bit for bit.

    Raises:
        SourceError: unreadable, or the size is not a multiple of 16 bytes.
    """
    return _split(read_rows(path, 4))


def read_points_with_rings(
    path: Path,
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.int64] | None]:
    """Read nuScenes' ``.pcd.bin``, float32 x, y, z, intensity, ring: points ``(N, 3)``, intensity and rings ``(N,)``; None where the fifth number is no ring.

    Raises:
        SourceError: unreadable, or the size is not a multiple of 20 bytes.
    """
    rows = read_rows(path, 5)
    return *_split(rows), _rings(rows[:, 4])


def looks_wide(rows: NDArray[np.float32]) -> bool:
    """Tell whether rows ``(N, 4)`` are rows of five numbers read as rows of four.

    Then every fifth number is a ring or a time: whole, or never smaller than the one before, while the numbers between are not.
    """
    flat = rows.reshape(-1)
    if len(flat) % 5 or len(rows) < _FEWEST_TO_TELL:
        return False
    wide = flat.reshape(-1, 5)
    fifth = wide[:, 4]
    if not np.isfinite(fifth).all() or (fifth == fifth[0]).all():
        return False
    with np.errstate(invalid="ignore"):
        others_whole = (wide[:, :3] == np.rint(wide[:, :3])).mean()
    rising = bool((np.diff(fifth) >= 0).all())
    return bool(others_whole < 0.5) and (rising or _rings(fifth) is not None)


def _split(rows: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    return np.ascontiguousarray(rows[:, :3]), np.ascontiguousarray(rows[:, 3])


def _rings(column: NDArray[np.float32]) -> NDArray[np.int64] | None:
    """Numbers ``(N,)`` as numbers of rings; None where they are no such thing."""
    with np.errstate(invalid="ignore"):
        sound = bool(((column == np.rint(column)) & (column >= 0) & (column < 4096)).all())
    return column.astype(np.int64) if sound else None


def points_to_bytes(points: NDArray[np.float32], intensity: NDArray[np.float32]) -> bytes:
    """Return the content of a ``.bin``; inverse of :func:`read_points`."""
    rows = np.empty((len(points), 4), "<u4")
    # Copied as integers, so that no bit of a NaN changes on the way.
    rows[:, :3] = np.ascontiguousarray(points, "<f4").view("<u4")
    rows[:, 3] = np.ascontiguousarray(intensity, "<f4").view("<u4")
    return rows.tobytes()


def scan_files(folder: Path) -> list[Path]:
    """List the ``.bin`` files of a folder, sorted; hidden ones, such as macOS leaves beside each file, are none."""
    return sorted(file for file in folder.glob("*.bin") if not file.name.startswith("."))


def list_scans(
    folder: Path, times: list[int | None] | None, times_file: Path, labels: Path | None
) -> list[ScanRef]:
    """List the ``.bin`` files of a folder.

    A stem of digits is the frame number; where no name is one, scans are numbered by their place in sorted order.

    Args:
        times: nanoseconds by frame number, None for one that is not known; None for a nominal 10 Hz.
        times_file: that they are from.
        labels: folder of ``.label`` files with the same stems, or None.

    Raises:
        SourceError: it cannot be told which frame a scan is, or what its time is.
    """
    files = scan_files(folder)
    odd = [file.name for file in files if not re.fullmatch(r"[0-9]+", file.stem)]
    if 0 < len(odd) < len(files):
        raise SourceError(
            f"{folder}: {odd[0]} is not named by a frame number as others are; move it elsewhere"
        )
    numbers = list(range(len(files))) if odd else [int(file.stem) for file in files]
    if len(set(numbers)) < len(numbers):
        raise SourceError(f"{folder}: two scans of one frame number; move one of them elsewhere")
    if times is not None and odd and len(times) != len(files):
        raise SourceError(
            f"{times_file}: {len(times)} lines for {len(files)} scans; complete it, or move it elsewhere: then scans are taken to be 0.1 s apart"
        )
    # One listing, for asking a store about each of them takes minutes.
    labelled = {file.name: str(file) for file in labels.glob("*.label")} if labels is not None else {}
    refs = []
    for number, file in zip(numbers, files, strict=True):
        time = (
            number * NOMINAL_PERIOD_NS if times is None else (times[number] if number < len(times) else None)
        )
        if time is None:
            raise SourceError(
                f"{times_file}: no time for frame {number}, which is there ({file.name}); complete it, or move it "
                "elsewhere: then scans are taken to be 0.1 s apart"
            )
        refs.append(ScanRef(file.stem, number, str(file), time, labelled.get(f"{file.stem}.label")))
    return sorted(refs, key=lambda ref: ref.number)
