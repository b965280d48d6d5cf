"""KITTI raw recordings: ``ROOT/DRIVE/velodyne_points/data/NAME.bin``, or any folder of ``.bin`` files."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path

from salpcc.schemas.errors import SourceError
from salpcc.schemas.scan import Scan
from salpcc.schemas.work import ScanRef
from salpcc.stages.ingest.sources.files import Files
from salpcc.stages.ingest.sources.frame_lines import frame_lines
from salpcc.stages.ingest.sources.velodyne_bin import list_scans, read_scan, scan_files


class KittiRaw(Files):
    """Uncompensated scans; the sequence is named by the folder of the drive."""

    name = "kitti_raw"
    hint = (
        "Raw drives: www.cvlibs.net/datasets/kitti/raw_data.php; "
        "expected ROOT/DRIVE/velodyne_points/data/*.bin, or ROOT/NAME/*.bin"
    )

    def sequences(self, root: Path) -> list[str]:
        """List drives: folders of ``root`` (one date folder deep, too) that hold scans."""
        if not root.is_dir():
            return []
        folders = (p for p in root.iterdir() if p.is_dir() and not p.name.startswith("."))
        return sorted(p.name for p in folders if _data_folder(p) is not None)

    def folder(self, root: Path, sequence: str) -> Path:
        """Return the folder of the drive; the downloads unpack into a folder per day: 2011_09_26/2011_09_26_drive_0005_sync."""
        folder, of_day = root / sequence, root / sequence[:10] / sequence
        return of_day if not folder.is_dir() and of_day.is_dir() else folder

    def scans(self, root: Path, sequence: str) -> list[ScanRef]:
        """List the scans of ``root/sequence``; times from timestamps.txt, else a nominal 10 Hz."""
        folder = self.folder(root, sequence)
        data = _data_folder(folder)
        if data is None:
            raise SourceError(f"{folder}: no .bin scans found. {self.hint}")
        stamps = data.parent / "timestamps.txt"
        return list_scans(data, read_timestamps(stamps), stamps, None)

    def read(self, ref: ScanRef, with_labels: bool) -> Scan:
        """Read points; there are no labels to raw drives."""
        if with_labels:
            raise SourceError(f"{ref.path}: raw drives have no labels; use --labels network")
        return read_scan(ref)


def _data_folder(folder: Path) -> Path | None:
    for candidate in (folder / "velodyne_points" / "data", folder):
        if scan_files(candidate):
            return candidate
    return None


def read_timestamps(path: Path) -> list[int | None] | None:
    """Read nanoseconds since the first time stamp from a file of dates, one a frame; None where there is no file.

    KITTI leaves a blank line where a scan is missing: its frame has no time.

    Raises:
        SourceError: unreadable, or a line is no date.
    """
    if not path.is_file():
        return None
    stamps: list[int | None] = []
    for at, line in enumerate(frame_lines(path)):
        try:
            stamps.append(_nanoseconds(line) if line else None)
        except ValueError as error:
            raise SourceError(f"{path}: line {at + 1}: {error}") from error
    first = next((stamp for stamp in stamps if stamp is not None), 0)
    return [None if stamp is None else stamp - first for stamp in stamps]


def _nanoseconds(line: str) -> int:
    """Parse ``2011-09-26 13:02:25.951199337``; datetime itself stops at microseconds."""
    whole, _, fraction = line.strip().partition(".")
    seconds = datetime.fromisoformat(whole + "+00:00").timestamp()
    return int(seconds) * 1_000_000_000 + int(fraction.ljust(9, "0")[:9] or "0")
