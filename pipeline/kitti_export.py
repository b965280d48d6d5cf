"""Write decoded scans as a sequence of SemanticKITTI: scans, labels, times."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from salpcc.pipeline.archive import Archive
from salpcc.pipeline.tell import Tell, in_silence
from salpcc.schemas.errors import UsageError
from salpcc.schemas.files import atomic
from salpcc.schemas.labels import labels_of_classes
from salpcc.schemas.scan import Scan
from salpcc.stages.ingest.point_cloud import point_rows
from salpcc.stages.ingest.sources.frame_lines import frame_lines
from salpcc.stages.ingest.sources.velodyne_bin import points_to_bytes

_LAST_FRAME = 10_000_000  # larger numbers in names are times, not frames


def to_kitti(archive: Archive, scans: Iterator[Scan], out: Path, tell: Tell = in_silence) -> Iterator[Path]:
    """Write ``velodyne/NAME.bin``, the files that an archive was made from, below ``out/sequences/SEQ``.

    Beside them what it holds else: the classes as ``labels/NAME.label`` (without instances, which no archive holds),
    the times in ``times.txt``. It holds no poses.

    Raises:
        UsageError: other labels are there, that these must not replace.
    """
    folder = out / "sequences" / archive.sequence
    wide = archive.config.get("columns", 4) > 4  # then a scan's rows are those of its cloud
    times: dict[str, int] = {}
    behind: set[str] = set()
    for scan in scans:
        if scan.cloud is not None and not wide:
            behind |= {field.name for field in scan.cloud.layout.fields} - {"x", "y", "z", "intensity"}
        path = folder / "velodyne" / f"{scan.name}.bin"
        with atomic(path) as stream:
            stream.write(point_rows(scan).tobytes() if wide else points_to_bytes(scan.points, scan.intensity))
        if scan.classes is not None:
            _write_labels(folder / "labels" / f"{scan.name}.label", scan)
        times[scan.name] = scan.time
        yield path
    if times:
        _write_times(folder / "times.txt", times, tell)
    if behind:
        tell(
            f"KITTI's files hold x, y, z, intensity: {', '.join(sorted(behind))} stay behind; --to ply has them"
        )


def _write_labels(path: Path, scan: Scan) -> None:
    assert scan.classes is not None
    labels = labels_of_classes(scan.classes).astype("<u4").tobytes()
    if path.is_file() and path.read_bytes() != labels:
        raise UsageError(f"{path}: other labels are there; name an empty folder with --out")
    with atomic(path) as stream:
        stream.write(labels)


def _write_times(path: Path, times: dict[str, int], tell: Tell) -> None:
    """Write seconds, one a line: by frame number where names are numbers, blank where none is known; else in their order.

    Lines of other frames that are there already stay.
    """
    seconds = {name: f"{time // 10**9}.{time % 10**9:09d}" for name, time in times.items()}
    if not all(name.isascii() and name.isdigit() for name in times):
        lines = [seconds[name] for name in sorted(seconds)]
    elif max(map(int, times)) > _LAST_FRAME:
        tell("times.txt is left out: the names of these scans are no frame numbers")
        return
    else:
        lines = frame_lines(path) if path.is_file() else []
        lines += [""] * (max(map(int, times)) + 1 - len(lines))
        for name, text in seconds.items():
            lines[int(name)] = text
    with atomic(path) as stream:
        stream.write(("\n".join(lines) + "\n").encode())
