"""The evaluate stage: measure what an archive gives back, one METRICS row per scan.

It is handed decoded scans as an iterator and never the encoder's copy, so what it measures is what a user
would get. Columns: :data:`salpcc.stages.evaluate.schema.METRICS`.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from salpcc.schemas.errors import ArchiveError
from salpcc.schemas.labels import CLASSES
from salpcc.schemas.scan import Scan
from salpcc.stages.evaluate.confusion import class_confusion, group_confusion, predicted_groups
from salpcc.stages.evaluate.match import kept_points
from salpcc.stages.evaluate.metrics import point_errors, same_bits, symmetric_distance
from salpcc.stages.evaluate.schema import METRICS, VERSION

__all__ = ["VERSION", "run"]


def run(
    decoded: Iterable[Scan],
    originals: Iterable[Scan | None],
    payloads: pa.Table,
    *,
    sequence: str,
    gop: int,
    max_error: float = 0.0,
    kept: Sequence[NDArray[np.bool_] | None] | None = None,
    predicted: Sequence[NDArray[np.uint8] | None] | None = None,
    sample: bool = False,
) -> pa.Table:
    """Measure the scans of one GOP.

    Args:
        decoded: scans decoded from the archive, in its order; pulled one by one, and the CPU time of each
            pull is the decode time, so pass the decoder's own iterator.
        originals: the source scans in the same order; None where there is none to compare with.
        payloads: rows of the same scans with columns ``name``, ``n_points``, ``kept``, ``dropped_movable``,
            ``strays``, ``geometry``, ``intensity``, ``classes``, ``side`` (the PAYLOAD table).
        max_error: the asked 3-D bound in metres, 0 for bit-exact.
        kept: per scan the mask of source points that the task kept, where known; else it is found again.
        predicted: per scan the segmenter's classes of all source points, where known; without it, class
            IoU is given only for scans that dropped nothing.
        sample: keep the first scan's points, for the pictures of the report.

    Raises:
        ArchiveError: the archive gives fewer or more scans than its payloads, or in another order.
    """
    rows: list[dict[str, Any]] = []
    pulls = _timed(decoded)
    sources = iter(originals)
    for index, payload in enumerate(payloads.to_pylist()):
        scan, decode_ms = next(pulls, (None, 0.0))
        if scan is None or scan.name != payload["name"]:
            found = "no more scans" if scan is None else f"scan {scan.name}"
            raise ArchiveError(
                f"sequence {sequence}, GOP {gop}: expected scan {payload['name']}, decoded {found}"
            )
        row = _sizes(payload) | {"sequence": sequence, "gop": gop, "time": scan.time, "decode_ms": decode_ms}
        row["points_decoded"] = len(scan)
        source = next(sources, None)
        if source is not None:
            mask = kept[index] if kept is not None else None
            classes = predicted[index] if predicted is not None else None
            row |= _compare(source, scan, max_error, mask, classes, sample and index == 0)
        rows.append(row)
    return pa.Table.from_pylist(rows, schema=METRICS)


def _timed(decoded: Iterable[Scan]) -> Iterator[tuple[Scan | None, float]]:
    """Yield each scan with the CPU milliseconds that it took to come."""
    scans = iter(decoded)
    while True:
        start = time.thread_time()
        scan = next(scans, None)
        yield scan, 1e3 * (time.thread_time() - start)
        if scan is None:
            return


def _sizes(payload: Mapping[str, Any]) -> dict[str, Any]:
    """Rename what the PAYLOAD row knows about sizes and counts."""
    return {
        "name": payload["name"],
        "points_in": payload["n_points"],
        "points_kept": payload["kept"],
        "points_dropped_movable": payload["dropped_movable"],
        "points_on_fallback": payload["strays"],
        "bytes_geometry": payload["geometry"],
        "bytes_intensity": payload["intensity"],
        "bytes_classes": payload["classes"],
        "bytes_side": payload["side"],
    }


def _compare(
    source: Scan,
    decoded: Scan,
    max_error: float,
    kept: NDArray[np.bool_] | None,
    predicted: NDArray[np.uint8] | None,
    sample: bool,
) -> dict[str, Any]:
    """Measure one decoded scan against its source."""
    if kept is None or kept.sum() != len(decoded):
        kept = kept_points(source, decoded, max_error)
    if kept is None:  # no in-order correspondence exists: nothing can be claimed but the failure
        return {"points_compared": 0, "max_error_m": np.inf, "bit_exact": False, "intensity_exact": False}
    points, intensity = source.points[kept], source.intensity[kept]
    errors = point_errors(points, decoded.points)
    exact_points = same_bits(points, decoded.points)
    exact_intensity = same_bits(intensity, decoded.intensity)
    row: dict[str, Any] = {
        "points_compared": len(decoded),
        "max_error_m": errors.maximum,
        "max_axis_error_m": errors.max_axis,
        "squared_error_m2": errors.sum_of_squares,
        "d_d_m2": 0.0 if exact_points else symmetric_distance(points, decoded.points),
        "bit_exact": exact_points and exact_intensity,
        "intensity_exact": exact_intensity,
    }
    row |= _segmentation(source, decoded, kept, predicted)
    if sample:
        row["sample_points"] = decoded.points.ravel()
        row["sample_error_m"] = errors.distance.astype(np.float32)
        row["sample_classes"] = decoded.classes
    return row


def _segmentation(
    source: Scan, decoded: Scan, kept: NDArray[np.bool_], predicted: NDArray[np.uint8] | None
) -> dict[str, Any]:
    """Count the predicted classes against the given labels, where both exist."""
    if source.classes is None or (decoded.classes is None and predicted is None):
        return {}
    if predicted is None and decoded.classes is not None:
        groups = predicted_groups(kept, decoded.classes)
        predicted = decoded.classes if kept.all() else None
    else:
        assert predicted is not None
        groups = np.asarray([c.group for c in CLASSES], np.uint8)[predicted]
    row: dict[str, Any] = {"group_confusion": group_confusion(source.classes, groups).ravel()}
    counts = class_confusion(source.classes, predicted) if predicted is not None else None
    if counts is not None:
        row["class_confusion"] = counts.ravel()
    return row
