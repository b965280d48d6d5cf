"""KITTI raw recordings: ``ROOT/DRIVE/velodyne_points/data/NAME.bin``, or any folder of ``.bin`` files."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path

from salpcc.schemas.errors import SourceError
from salpcc.schemas.files import location
from salpcc.schemas.scan import Scan
from salpcc.schemas.work import ScanRef
from salpcc.stages.ingest.sources.velodyne_bin import list_scans, read_points


class KittiRaw:
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
        return sorted(p.name for p in root.iterdir() if p.is_dir() and _data_folder(p) is not None)

    def scans(self, root: Path, sequence: str) -> list[ScanRef]:
        """List the scans of ``root/sequence``; times from timestamps.txt, else a nominal 10 Hz."""
        folder = root / sequence
        # The downloads unpack into a folder per day: 2011_09_26/2011_09_26_drive_0005_sync.
        if not folder.is_dir() and (root / sequence[:10] / sequence).is_dir():
            folder = root / sequence[:10] / sequence
        data = _data_folder(folder)
        if data is None:
            raise SourceError(f"{folder}: no .bin scans found. {self.hint}")
        return list_scans(data, read_timestamps(data.parent / "timestamps.txt"), None)

    def read(self, ref: ScanRef, with_labels: bool) -> Scan:
        """Read points; there are no labels to raw drives."""
        if with_labels:
            raise SourceError(f"{ref.path}: raw drives have no labels; use --labels network")
        points, intensity = read_points(location(ref.path))
        return Scan(ref.name, points, intensity, ref.time)


def _data_folder(folder: Path) -> Path | None:
    for candidate in (folder / "velodyne_points" / "data", folder):
        if next(candidate.glob("*.bin"), None) is not None:
            return candidate
    return None


def read_timestamps(path: Path) -> list[int] | None:
    """Read nanoseconds since the first line from a file of dates, or None where there is no file."""
    if not path.is_file():
        return None
    try:
        stamps = [_nanoseconds(line) for line in path.read_text().splitlines() if line.strip()]
    except ValueError as error:
        raise SourceError(f"{path}: {error}") from error
    return [stamp - stamps[0] for stamp in stamps]


def _nanoseconds(line: str) -> int:
    """Parse ``2011-09-26 13:02:25.951199337``; datetime itself stops at microseconds."""
    whole, _, fraction = line.strip().partition(".")
    seconds = datetime.fromisoformat(whole + "+00:00").timestamp()
    return int(seconds) * 1_000_000_000 + int(fraction.ljust(9, "0")[:9] or "0")
