"""SemanticKITTI / KITTI odometry: ``ROOT/sequences/SEQ/{velodyne,labels}/NAME.{bin,label}``, times.txt."""

from __future__ import annotations

from dataclasses import replace
from decimal import Decimal
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from salpcc.schemas.errors import SourceError
from salpcc.schemas.labels import classes_of_labels
from salpcc.schemas.scan import Scan
from salpcc.schemas.work import ScanRef
from salpcc.stages.ingest.sources.files import Files
from salpcc.stages.ingest.sources.frame_lines import frame_lines
from salpcc.stages.ingest.sources.label_files import label_file, labels_that_fit
from salpcc.stages.ingest.sources.velodyne_bin import list_scans, read_scan


class SemanticKitti(Files):
    """Motion-compensated scans of 22 sequences, labels for 00 to 10."""

    name = "semantickitti"
    hint = (
        "Velodyne scans: www.cvlibs.net/datasets/kitti/eval_odometry.php; "
        "labels: semantic-kitti.org; expected ROOT/sequences/SEQ/velodyne/*.bin"
    )

    def sequences(self, root: Path) -> list[str]:
        """List sequences: folders below ``root/sequences`` that hold a ``velodyne`` folder."""
        folders = (p for p in (root / "sequences").glob("*/velodyne") if p.is_dir())
        return sorted(p.parent.name for p in folders if not p.parent.name.startswith("."))

    def folder(self, root: Path, sequence: str) -> Path:
        """Return ``root/sequences/sequence``."""
        return root / "sequences" / sequence

    def scans(self, root: Path, sequence: str) -> list[ScanRef]:
        """List the scans of ``root/sequences/sequence``; times from times.txt (seconds, one a line)."""
        folder = self.folder(root, sequence)
        if not (folder / "velodyne").is_dir():
            raise SourceError(f"{folder / 'velodyne'}: not found. {self.hint}")
        times = folder / "times.txt"
        return list_scans(folder / "velodyne", read_times(times), times, folder / "labels")

    def read(self, ref: ScanRef, with_labels: bool) -> Scan:
        """Read points and, where asked, the classes of the ``.label`` file."""
        scan = read_scan(ref)
        return replace(scan, classes=read_classes(ref, len(scan))) if with_labels else scan


def read_times(path: Path) -> list[int | None] | None:
    """Read nanoseconds by frame number from a file of seconds, one a line; None where there is no file.

    A blank line is a frame without a time.

    Raises:
        SourceError: unreadable, or a line is not one number that nanoseconds can hold.
    """
    if not path.is_file():
        return None
    times: list[int | None] = []
    for at, line in enumerate(frame_lines(path)):
        try:
            times.append(round(Decimal(line) * 10**9) if line else None)
        except (ArithmeticError, ValueError) as error:
            raise SourceError(f"{path}: line {at + 1}, {line!r}, is not one number of seconds") from error
        if not 0 <= (times[-1] or 0) < 1 << 63:
            raise SourceError(f"{path}: line {at + 1}: negative, or too large for nanoseconds in 63 bits")
    return times


def read_classes(ref: ScanRef, n_points: int) -> NDArray[np.uint8]:
    """Read the class ``(N,)`` of each point from the ``.label`` file (uint32, lower 16 bits are the class).

    Raises:
        SourceError: no labels, not one per point, or an unknown label.
    """
    labels = read_labels(ref, n_points)
    try:
        return classes_of_labels(labels)
    except ValueError as error:
        raise SourceError(f"{ref.labels}: {error}") from error


def read_labels(ref: ScanRef, n_points: int) -> NDArray[np.uint32]:
    """Read the ``.label`` file as it is: ``(N,)`` uint32, class below, instance in the upper 16 bits.

    Raises:
        SourceError: no labels, or not one per point.
    """
    if ref.labels is None:
        raise SourceError(f"{ref.path}: no .label file beside it; use --labels network")
    labels = labels_that_fit(ref, n_points)
    if labels is None:
        size = len(label_file(ref.labels))
        raise SourceError(
            f"{ref.labels}: {size} bytes for {n_points} points, expected 4 bytes a point; use --labels network"
        )
    return labels
