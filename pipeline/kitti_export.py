"""Write decoded scans as a sequence of SemanticKITTI: scans, labels, times."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from salpcc.pipeline.archive import Archive
from salpcc.pipeline.kitti_files import label_bytes, scan_bytes, times_bytes
from salpcc.pipeline.tell import Tell, in_silence
from salpcc.schemas.errors import UsageError
from salpcc.schemas.files import atomic
from salpcc.schemas.scan import Scan
from salpcc.stages.ingest.sources.frame_lines import frame_lines


def to_kitti(archive: Archive, scans: Iterator[Scan], out: Path, tell: Tell = in_silence) -> Iterator[Path]:
    """Write ``velodyne/NAME.bin``, the files that an archive was made from, below ``out/sequences/SEQ``.

    Beside them what it holds else: the classes as ``labels/NAME.label`` (without instances, which no archive holds),
    the times in ``times.txt``. It holds no poses.

    Raises:
        UsageError: other labels are there, that these must not replace.
    """
    folder = out / "sequences" / archive.sequence
    columns = archive.config.get("columns", 4)
    times: dict[str, int] = {}
    behind: set[str] = set()
    for scan in scans:
        if scan.cloud is not None and columns == 4:
            behind |= {field.name for field in scan.cloud.layout.fields} - {"x", "y", "z", "intensity"}
        path = folder / "velodyne" / f"{scan.name}.bin"
        with atomic(path) as stream:
            stream.write(scan_bytes(scan, columns))
        if (labels := label_bytes(scan)) is not None:
            _write_labels(folder / "labels" / f"{scan.name}.label", labels)
        times[scan.name] = scan.time
        yield path
    if times:
        _write_times(folder / "times.txt", times, tell)
    if behind:
        tell(
            f"KITTI's files hold x, y, z, intensity: {', '.join(sorted(behind))} stay behind; --to ply has them"
        )


def _write_labels(path: Path, labels: bytes) -> None:
    if path.is_file() and path.read_bytes() != labels:
        raise UsageError(f"{path}: other labels are there; name an empty folder with --out")
    with atomic(path) as stream:
        stream.write(labels)


def _write_times(path: Path, times: dict[str, int], tell: Tell) -> None:
    """Write the times; lines of other frames that are there already stay."""
    text = times_bytes(times, frame_lines(path) if path.is_file() else [])
    if text is None:
        tell("times.txt is left out: the names of these scans are no frame numbers")
        return
    with atomic(path) as stream:
        stream.write(text)
