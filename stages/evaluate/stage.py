"""The evaluate stage: measure what an archive gives back, one METRICS row per scan.

It is handed decoded scans as an iterator and never the encoder's copy, so what it measures is what a user
would get. Columns: :data:`salpcc.stages.evaluate.report.schema.METRICS`.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from salpcc.schemas.config import GRID_ACCURACY
from salpcc.schemas.errors import ArchiveError
from salpcc.schemas.labels import CLASSES, GROUP_OF_CLASS, MOVABLE
from salpcc.schemas.scan import Scan
from salpcc.schemas.shards import KEPT
from salpcc.stages.evaluate.measures.match import kept_points
from salpcc.stages.evaluate.measures.metrics import (
    SOURCE_BYTES_PER_POINT,
    point_errors,
    same_bits,
    symmetric_distance,
)
from salpcc.stages.evaluate.report.schema import METRICS, VERSION
from salpcc.stages.ingest.paper_grid import source_of
from salpcc.stages.ingest.point_cloud import same_message
from salpcc.stages.lattice.aim import given_back
from salpcc.stages.lattice.sensor_model import SensorModel
from salpcc.stages.segment.confusion import class_confusion, group_counts

__all__ = ["VERSION", "run"]

_Dropped = Mapping[str, NDArray[np.uint8] | None]


def run(
    decoded: Iterable[Scan],
    originals: Iterable[Scan | None],
    payloads: pa.Table,
    *,
    sequence: str,
    gop: int,
    sensor: SensorModel | None = None,
    max_error: float = 0.0,
    dropped: _Dropped | None = None,
    found: _Dropped | None = None,
    in_order: bool = True,
    sample: bool = False,
) -> pa.Table:
    """Measure the scans of one GOP.

    Args:
        decoded: scans decoded from the archive, in its order; pulled one by one, and the CPU time of each
            pull is the decode time, so pass the decoder's own iterator.
        originals: the source scans in the same order; None where there is none to compare with.
        payloads: rows of the same scans with columns ``name``, ``n_points``, ``kept``, ``dropped_movable``,
            ``geometry``, ``intensity``, ``classes``, ``side`` (the PAYLOAD table), and ``off_lattice``: points that no lattice explains.
            Where they are known, ``bit_identical``: points that need no correction, and ``unmoved``: whether all lie where the sensor saw them.
        sensor: the archive's.
        max_error: the asked 3-D bound in metres, 0 for bit-exact.
        dropped: by scan the class ``(N,)`` of each source point that the task dropped, KEPT elsewhere (None: it
            dropped nothing). Without it, what was kept is found again and taken for movable what was not, and
            class IoU is given only for scans that dropped nothing.
        found: by scan the class ``(N,)`` that was found for each source point, where the archive holds none: what is in its
            movable layer counts as movable.
        in_order: whether the archive keeps the order of points; else it is of the grid of profile ``paper``,
            and ``max_error`` its accuracy.
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
            came = "no more scans" if scan is None else f"scan {scan.name}"
            raise ArchiveError(
                f"sequence {sequence}, GOP {gop}: expected scan {payload['name']}, decoded {came}"
            )
        row = _sizes(payload) | {"sequence": sequence, "gop": gop, "time": scan.time, "decode_ms": decode_ms}
        row["points_decoded"] = len(scan)
        row["points_bit_identical"] = _bit_identical(payload, scan, sensor, max_error)
        row["motion"] = scan.motion
        row["bytes_source"] = row["points_in"] * (
            scan.cloud.layout.point_step if scan.cloud else SOURCE_BYTES_PER_POINT
        )
        source = next(sources, None)
        if source is not None:
            known = _known(source, dropped or {})
            if in_order:
                classes = (found or {}).get(source.name)
                row |= _compare(source, scan, max_error, known, classes, sample and index == 0)
                row["class_counts"] = _class_counts(source, scan, known, classes)
            else:
                row |= _compare_unordered(
                    source, scan, max_error or GRID_ACCURACY, known, sample and index == 0
                )
        rows.append(row)
    return pa.Table.from_pylist(rows, schema=METRICS)


def _bit_identical(
    payload: Mapping[str, Any], scan: Scan, sensor: SensorModel | None, max_error: float
) -> int | None:
    """Points of a scan that laser, tick and count give back bit for bit, as the encoder counted them, else by the model; None where it cannot tell."""
    if payload.get("bit_identical") is not None or max_error > 0:
        return payload.get("bit_identical") or 0
    if sensor is None or not payload.get("unmoved"):
        return None
    return int(given_back(sensor, scan.points).sum()) if sensor.driver is not None else 0


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
        "points_on_fallback": payload["off_lattice"],
        "movable": payload.get("movable"),
        "points_movable": payload.get("points_movable"),
        "bytes_movable": payload.get("bytes_movable"),
        "bytes_geometry": payload["geometry"],
        "bytes_intensity": payload["intensity"],
        "bytes_classes": payload["classes"],
        "bytes_side": payload["side"],
        "checksum": payload.get("checksum"),
        "laser_returns": payload.get("laser_returns"),
        "laser_bits": payload.get("laser_bits"),
    }


def _known(source: Scan, dropped: _Dropped) -> NDArray[np.uint8] | None:
    """The classes of what a scan dropped, KEPT where it kept; None where they are not known."""
    if source.name not in dropped:
        return None
    classes = dropped[source.name]
    return np.full(len(source), KEPT, np.uint8) if classes is None else classes


def _class_counts(
    source: Scan, decoded: Scan, dropped: NDArray[np.uint8] | None, found: NDArray[np.uint8] | None
) -> NDArray[np.int64] | None:
    """Count the points of a source scan by class; None where the classes of some are not known."""
    if found is None and decoded.classes is not None:
        gone = () if dropped is None else dropped[dropped != KEPT]
        found = np.concatenate([decoded.classes, gone]).astype(np.uint8)
    if found is None or len(found) != len(source):
        return None
    return np.bincount(found, minlength=len(CLASSES))


def _compare(
    source: Scan,
    decoded: Scan,
    max_error: float,
    dropped: NDArray[np.uint8] | None,
    found: NDArray[np.uint8] | None,
    sample: bool,
) -> dict[str, Any]:
    """Measure one decoded scan against its source, point by point."""
    kept = None if dropped is None else dropped == KEPT
    if kept is None or kept.sum() != len(decoded):
        dropped, kept = None, kept_points(source, decoded, max_error)
    if kept is None:  # no in-order correspondence exists: nothing can be claimed but the failure
        return {"points_compared": 0, "max_error_m": np.inf, "bit_exact": False, "intensity_exact": False}
    points, intensity = source.points[kept], source.intensity[kept]
    errors = point_errors(points, decoded.points)
    exact_points = same_bits(points, decoded.points)
    exact_intensity = same_bits(intensity, decoded.intensity)
    row: dict[str, Any] = {
        "in_order": True,
        "points_compared": len(decoded),
        "max_error_m": errors.maximum,
        "max_axis_error_m": errors.max_axis,
        "squared_error_m2": errors.sum_of_squares,
        "d_d_m2": 0.0 if exact_points else symmetric_distance(points, decoded.points),
        "bit_exact": exact_points and exact_intensity and _same_message(source, decoded, kept),
        "intensity_exact": exact_intensity,
    }
    if decoded.classes is None and found is not None and len(found) == len(source):
        decoded = replace(decoded, classes=found[kept])
    if sample:
        row |= _sample(decoded, errors.distance)
    return row | _segmentation(source, decoded, kept, dropped, sample)


def _compare_unordered(
    source: Scan, decoded: Scan, accuracy: float, dropped: NDArray[np.uint8] | None, sample: bool
) -> dict[str, Any]:
    """Measure one decoded scan of the grid: each point against the source point that its cell kept.

    The grid loses the order, and points that collide; D_d finds those too, the errors do not.
    """
    row: dict[str, Any] = {"in_order": False, "points_compared": len(decoded), "bit_exact": False}
    index = source_of(decoded, source, accuracy)
    if index is None:
        return row | {"points_compared": 0, "max_error_m": np.inf, "intensity_exact": False}
    errors = point_errors(source.points[index], decoded.points)
    points = source.points if dropped is None else source.points[dropped == KEPT]
    row |= {
        "max_error_m": errors.maximum,
        "max_axis_error_m": errors.max_axis,
        "squared_error_m2": errors.sum_of_squares,
        "d_d_m2": symmetric_distance(points, decoded.points),
        "intensity_exact": True,  # source_of asks for it
    }
    if sample:
        row |= _sample(decoded, errors.distance)
    return row


def _sample(decoded: Scan, distance: NDArray[np.float64]) -> dict[str, Any]:
    """What the pictures of a decoded scan are drawn from."""
    return {
        "sample_points": decoded.points.ravel(),
        "sample_intensity": decoded.intensity,
        "sample_error_m": distance.astype(np.float32),
        "sample_classes": decoded.classes,
    }


def _same_message(source: Scan, decoded: Scan, kept: NDArray[np.bool_]) -> bool:
    """Tell whether what a recorded message held besides its points is the same; True for other scans."""
    return same_message(source.cloud and source.cloud.keep(kept), decoded.cloud)


def _segmentation(
    source: Scan,
    decoded: Scan,
    kept: NDArray[np.bool_],
    dropped: NDArray[np.uint8] | None,
    sample: bool,
) -> dict[str, Any]:
    """Count the predicted classes against the given labels, where both exist; what was dropped is movable."""
    if source.classes is None or decoded.classes is None:
        return {}
    groups = np.full(len(source), MOVABLE, np.uint8)
    groups[kept] = GROUP_OF_CLASS[decoded.classes]
    if decoded.movable is not None:
        groups[np.flatnonzero(kept)[decoded.movable]] = MOVABLE
    row: dict[str, Any] = {"group_counts": group_counts(source.classes, groups).ravel()}
    if dropped is None and not kept.all():
        return row
    predicted = np.empty(len(source), np.uint8) if dropped is None else dropped.copy()
    predicted[kept] = decoded.classes
    counts = class_confusion(source.classes, predicted)
    if counts is not None:
        row["class_confusion"] = counts.ravel()
    if sample:
        centimetres = np.nan_to_num(np.rint(100.0 * source.points), posinf=0.0, neginf=0.0)
        row |= {"sample_source": np.clip(centimetres, -32767, 32767).astype(np.int16).ravel()}
        row["sample_truth"] = source.classes
        row["sample_predicted"] = predicted
    return row
