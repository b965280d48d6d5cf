"""The content of the files that SemanticKITTI has for a scan, and of the list of times beside them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from salpcc.schemas.labels import labels_of_classes
from salpcc.schemas.scan import Scan
from salpcc.stages.ingest.point_cloud import point_rows
from salpcc.stages.ingest.sources.velodyne_bin import points_to_bytes

_LAST_FRAME = 10_000_000  # larger numbers in names are times, not frames


def scan_bytes(scan: Scan, columns: int = 4) -> bytes:
    """Return ``velodyne/NAME.bin``; of more than four columns, the rows are those of the scan's cloud."""
    return point_rows(scan).tobytes() if columns > 4 else points_to_bytes(scan.points, scan.intensity)


def label_bytes(scan: Scan) -> bytes | None:
    """Return ``labels/NAME.label``: its labels as they were, else those of its classes; None where neither is known."""
    labels = scan.labels
    if labels is None and scan.classes is not None:
        labels = labels_of_classes(scan.classes)
    return None if labels is None else labels.astype("<u4").tobytes()


def times_bytes(times: Mapping[str, int], lines: Sequence[str] = ()) -> bytes | None:
    """Return ``times.txt``, seconds: by frame number where names are numbers, blank where none is known; else in their order.

    None where the names are numbers, but none of frames.

    Args:
        times: ns, by name.
        lines: that are there already, of other frames.
    """
    seconds = {name: f"{time // 10**9}.{time % 10**9:09d}" for name, time in times.items()}
    if not all(name.isascii() and name.isdigit() for name in times):
        found = [seconds[name] for name in sorted(seconds)]
    elif max(map(int, times), default=0) > _LAST_FRAME:
        return None
    else:
        found = [*lines, *[""] * (max(map(int, times), default=-1) + 1 - len(lines))]
        for name, text in seconds.items():
            found[int(name)] = text
    return ("\n".join(found) + "\n").encode()
