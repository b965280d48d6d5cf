"""Sum METRICS rows up to the figures of ``report.json``; the names are a contract (see ARCHITECTURE.md)."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from salpcc.schemas.labels import CLASSES, GROUPS, MOVABLE
from salpcc.stages.evaluate.measures.metrics import bits_per_point, compression_rate
from salpcc.stages.segment.confusion import (
    PAPER_CLASSES,
    group_confusion,
    intersection_over_union,
    mean_iou,
)

ENCODE_STAGES = ("ingest", "segment", "ground_fit", "predict", "residual_code")
STREAMS = ("geometry", "intensity", "classes", "side")


def figures(metrics: pa.Table, times: pa.Table, container_bytes: int = 0) -> dict[str, Any]:
    """Return one sequence's figures (or all sequences' together).

    Args:
        metrics: METRICS rows.
        times: TIMES rows of the same scans.
        container_bytes: what the archive file holds beside the payloads (framing, index, sensor model);
            counted as ``side``.
    """
    points = total(metrics, "points_in")
    sizes = {stream: total(metrics, f"bytes_{stream}") for stream in STREAMS}
    sizes["side"] += container_bytes
    sizes["total"] = sum(sizes[stream] for stream in STREAMS)
    dropped, decoded = total(metrics, "points_dropped_movable"), total(metrics, "points_decoded")
    stage_ms, encode_ms = encode_times(times)
    return {
        "frames": metrics.num_rows,
        "points_in": points,
        "points_kept": total(metrics, "points_kept"),
        "points_dropped_movable": dropped,
        "points_decoded": decoded,
        "points_lost": points - dropped - decoded,
        "points_on_fallback": total(metrics, "points_on_fallback"),
        "points_bit_identical": pc.sum(metrics.column("points_bit_identical")).as_py(),
        "bytes": sizes,
        "bytes_container": container_bytes,
        "bytes_source": total(metrics, "bytes_source"),
        "bpp": {key: bits_per_point(sizes[key], points) for key in ("geometry", "intensity", "total")},
        "compression_rate_percent": compression_rate(sizes["total"], points),
        "geometry_rate_percent": compression_rate(sizes["geometry"], points),
        **layer_figures(metrics),
        **error_figures(metrics),
        "bit_exact_scans": count(metrics, "bit_exact"),
        "intensity_exact_scans": count(metrics, "intensity_exact"),
        "ms_per_scan": stage_ms,
        "encode_ms_per_scan": encode_ms,
        "decode_ms_per_scan": median(metrics, "decode_ms"),
        "iou": iou_figures(metrics),
    }


def layer_figures(metrics: pa.Table) -> dict[str, Any]:
    """Say what became of what may move, and the points and bytes of each layer: payloads, without the container.

    ``layers`` is None where all is in one layer.
    """
    kinds = sorted(set(metrics.column("movable").drop_null().to_pylist()))
    if not kinds or kinds == ["one layer"]:
        return {"movable": kinds[0] if kinds else None, "layers": None}
    movable = {"points": total(metrics, "points_movable"), "bytes": total(metrics, "bytes_movable")}
    coded = sum(total(metrics, f"bytes_{stream}") for stream in STREAMS)
    static = {
        "points": total(metrics, "points_decoded") - movable["points"],
        "bytes": coded - movable["bytes"],
    }
    return {"movable": " and ".join(kinds), "layers": {"static": static, "movable": movable}}


def error_figures(rows: pa.Table) -> dict[str, Any]:
    """Maximal and RMS error and D_d over METRICS or BASELINES rows; None where nothing was compared.

    A scan without any correspondence to its source makes them None too, and is counted.
    """
    maximum = rows.column("max_error_m").drop_null().to_numpy()
    unmatched = int(np.isinf(maximum).sum())
    result: dict[str, Any] = {
        "max_error_m": None,
        "max_axis_error_m": None,
        "rms_error_m": None,
        "d_d": None,
        "scans_without_correspondence": unmatched,
    }
    if not len(maximum) or unmatched:
        return result
    compared = total(rows, "points_compared" if "points_compared" in rows.column_names else "points_decoded")
    d_d = rows.column("d_d_m2").drop_null().to_numpy()
    d_d = d_d[np.isfinite(d_d)]
    result["max_error_m"] = float(maximum.max())
    result["max_axis_error_m"] = float(rows.column("max_axis_error_m").drop_null().to_numpy().max())
    squares = float(rows.column("squared_error_m2").drop_null().to_numpy().sum())
    result["rms_error_m"] = float(np.sqrt(squares / compared)) if compared else 0.0
    result["d_d"] = float(d_d.mean()) if len(d_d) else None
    return result


def iou_figures(metrics: pa.Table) -> dict[str, Any] | None:
    """IoU of groups and classes summed over the scans that have labels, or None where none has.

    Terrain belongs to no group of the paper; ``groups`` counts it as other, ``groups_without_terrain`` not at all.
    """
    counts = _summed(metrics, "group_counts", (len(CLASSES), len(GROUPS)))
    if counts is None:
        return None
    groups = group_confusion(counts)
    hit, truth, said = groups[MOVABLE, MOVABLE], groups[MOVABLE].sum(), groups[:, MOVABLE].sum()
    classes = _summed(metrics, "class_confusion", (len(CLASSES), len(CLASSES)))
    scores = {} if classes is None else intersection_over_union(classes, [c.name for c in CLASSES])
    scores = {name: score for name, score in scores.items() if name != CLASSES[0].name}
    of_paper = {name: score for name, score in scores.items() if name in PAPER_CLASSES}
    return {
        "groups": dict(intersection_over_union(groups, GROUPS)),
        "groups_without_terrain": dict(
            intersection_over_union(group_confusion(counts, without=("terrain",)), GROUPS)
        ),
        "movable_recall": float(hit / truth) if truth else None,
        "movable_precision": float(hit / said) if said else None,
        "classes": scores,
        "miou": mean_iou(scores),
        "miou_paper": mean_iou(of_paper),  # over those of its twelve classes that occur
        "confusion": None if classes is None else classes.tolist(),
    }


def encode_times(times: pa.Table) -> tuple[dict[str, float], float | None]:
    """Median CPU ms a scan of each stage, and of all encoding stages together, over the GOPs."""
    per_stage: dict[str, list[float]] = {}
    per_gop: dict[tuple[str, int], float] = {}
    for row in times.to_pylist():
        if not row["scans"]:
            continue
        per_scan = row["cpu_ms"] / row["scans"]
        per_stage.setdefault(row["stage"], []).append(per_scan)
        if row["stage"] in ENCODE_STAGES:
            gop = (row["sequence"], row["gop"])
            per_gop[gop] = per_gop.get(gop, 0.0) + per_scan
    medians = {stage: float(np.median(values)) for stage, values in per_stage.items()}
    return medians, float(np.median(list(per_gop.values()))) if per_gop else None


def total(rows: pa.Table, column: str) -> int:
    """Sum of an integer column; nulls count nothing."""
    return int(pc.sum(rows.column(column)).as_py() or 0)


def count(rows: pa.Table, column: str) -> int:
    """Number of true values in a boolean column."""
    return int(pc.sum(pc.cast(rows.column(column), pa.int64())).as_py() or 0)


def median(rows: pa.Table, column: str) -> float | None:
    """Median of a column without its nulls, or None."""
    values = rows.column(column).drop_null().to_numpy()
    return float(np.median(values)) if len(values) else None


def _summed(
    metrics: pa.Table, column: str, shape: tuple[int, int]
) -> np.ndarray[Any, np.dtype[np.int64]] | None:
    """Add up the matrices of a column, or None where all are null."""
    matrices = [np.array(m, np.int64) for m in metrics.column(column).drop_null().to_pylist()]
    return np.sum(matrices, axis=0).reshape(shape) if matrices else None
