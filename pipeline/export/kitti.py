"""Write decoded scans as a sequence of SemanticKITTI: scans, labels, and the small files beside them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from salpcc.pipeline.archive import Archive
from salpcc.pipeline.export.beside import tell_what_stays
from salpcc.pipeline.export.new_files import write_new
from salpcc.pipeline.export.tell import Tell, in_silence
from salpcc.pipeline.files.kitti_files import label_bytes, scan_bytes, times_bytes
from salpcc.schemas.files import atomic
from salpcc.schemas.scan import Scan
from salpcc.stages.ingest.point_cloud import coordinate_rounding, scan_columns
from salpcc.stages.ingest.sources.frame_lines import frame_lines


def to_kitti(archive: Archive, scans: Iterator[Scan], out: Path, tell: Tell = in_silence) -> Iterator[Path]:
    """Write ``velodyne/NAME.bin``, the files that an archive was made from, below ``out/sequences/SEQ``.

    Beside them ``labels/NAME.label`` as they were, or made of the classes where it holds these only, and the side files
    (times, poses, calibration) as they were. Without side files the times go to ``times.txt``.

    Raises:
        UsageError: other points, labels or side files are there, that these must not replace.
    """
    folder = out / "sequences" / archive.sequence
    columns = archive.config.get("columns", 4)
    times: dict[str, int] = {}
    behind: set[str] = set()
    rounded: dict[str, float] = {}
    for scan in scans:
        if scan.cloud is not None and columns == 4:
            behind |= {field.name for field in scan.cloud.layout.fields} - {"x", "y", "z", "intensity"}
        for what, by in _rounding(scan).items() if columns == 4 else ():
            rounded[what] = max(by, rounded.get(what, 0.0))
        path = folder / "velodyne" / f"{scan.name}.bin"
        write_new(path, scan_bytes(scan, columns), "points are")
        name = f"labels/{scan.name}.label"  # a side file where it fitted no points
        if name not in archive.side and (labels := label_bytes(scan)) is not None:
            write_new(folder / name, labels, "labels are")
        times[scan.name] = scan.time
        if scan.offset is not None:
            behind.add("when each was measured (t)")
        yield path
    for name in archive.side if times else ():
        write_new(folder / name, archive.side_file(name), "content is")
    if times and not archive.side:
        _write_times(folder / "times.txt", times, tell)
    if behind:
        tell(
            f"KITTI's files hold x, y, z, intensity: {', '.join(sorted(behind))} stay behind; --to ply has them"
        )
    for what, by in rounded.items():
        tell(f"KITTI's files hold float32: {what} are rounded by up to {by:.3g}; --to ply has them")
    tell_what_stays(archive, "kitti", tell)


def _rounding(scan: Scan) -> dict[str, float]:
    """By how much float32 differs from what was recorded with another type: coordinates in metres, intensities."""
    found = {"coordinates": coordinate_rounding(scan)}
    layout = scan.cloud and scan.cloud.layout
    if layout and layout.intensity is not None and layout.slots[3] is None:
        wide = scan_columns(scan)["intensity"].astype(np.float64)
        with np.errstate(invalid="ignore"):
            off = np.abs(wide - scan.intensity)
        found["intensities"] = float(off[np.isfinite(wide)].max(initial=0.0))
    return {what: by for what, by in found.items() if by}


def _write_times(path: Path, times: dict[str, int], tell: Tell) -> None:
    """Write the times; lines of other frames that are there already stay."""
    text = times_bytes(times, frame_lines(path) if path.is_file() else [])
    if text is None:
        tell("times.txt is left out: the names of these scans are no frame numbers")
        return
    with atomic(path) as stream:
        stream.write(text)
