"""Sum BASELINES rows up per codec and asked error, with the names that the sequences use."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc

from salpcc.stages.evaluate.baselines import BASELINES
from salpcc.stages.evaluate.baselines.baseline import FLOAT32_SLACK
from salpcc.stages.evaluate.measures.aggregate import count, error_figures, median, total
from salpcc.stages.evaluate.measures.metrics import bits_per_point, compression_rate
from salpcc.stages.evaluate.report.bd_rate import bd_rate

OURS = "salpcc"
BD_REFERENCES = (OURS, "tmc13")


def baseline_figures(rows: pa.Table) -> dict[str, dict[str, dict[str, Any]]]:
    """Return ``{codec: {asked error in metres: figures}}``; the error "0" asks for bit-exactness."""
    result: dict[str, dict[str, dict[str, Any]]] = {}
    for name in _distinct(rows, "baseline"):
        mine = rows.filter(pc.equal(rows.column("baseline"), name))
        result[str(name)] = {
            f"{error:g}": _figures(mine.filter(pc.equal(mine.column("max_error"), error)))
            for error in sorted(_distinct(mine, "max_error"))
        }
    return result


def bd_rates(
    baselines: Mapping[str, Mapping[str, Mapping[str, Any]]],
) -> dict[str, dict[str, float | None]]:
    """Return ``{reference: {codec: percent}}``: how many more geometry bits a codec takes at the same D_d.

    References are ours and TMC13, where they were measured; None where the curves do not meet.
    """
    curves = {
        name: [(f["bpp"]["geometry"], f["d_d"]) for f in errors.values() if f["frames"] and f["d_d"]]
        for name, errors in baselines.items()
    }
    curves = {name: curve for name, curve in curves.items() if curve}
    return {
        reference: {
            name: bd_rate(curves[reference], curve) for name, curve in curves.items() if name != reference
        }
        for reference in BD_REFERENCES
        if reference in curves
    }


def _figures(rows: pa.Table) -> dict[str, Any]:
    """Figures of one codec at one asked error over the scans that it coded."""
    done = rows.filter(pc.equal(rows.column("status"), "ok"))
    if not done.num_rows:
        return {"status": rows.column("status")[0].as_py(), "frames": 0}
    points, geometry = total(done, "points_in"), total(done, "bytes_geometry")
    whole = None if done.column("bytes_total").null_count else total(done, "bytes_total")
    failed = rows.num_rows - done.num_rows
    return {
        "status": "ok" if not failed else _partly(rows),
        "frames": done.num_rows,
        "points_in": points,
        "points_decoded": total(done, "points_decoded"),
        "points_lost": points - total(done, "points_decoded"),
        "in_order": count(done, "in_order") == done.num_rows,
        "bytes": {
            "geometry": geometry,
            "intensity": None if whole is None else whole - geometry,
            "total": whole,
        },
        "bpp": {
            "geometry": bits_per_point(geometry, points),
            "intensity": None if whole is None else bits_per_point(whole - geometry, points),
            "total": None if whole is None else bits_per_point(whole, points),
        },
        "compression_rate_percent": None if whole is None else compression_rate(whole, points),
        "geometry_rate_percent": compression_rate(geometry, points),
        **error_figures(done),
        "bit_exact_scans": count(done, "bit_exact"),
        "promise_kept": _kept(done),
        "encode_ms_per_scan": median(done, "encode_ms"),
        "decode_ms_per_scan": median(done, "decode_ms"),
        "memory_mb": median(done, "memory_mb"),
    }


def _kept(done: pa.Table) -> bool | None:
    """Tell whether every scan came back within what the codec promises; None where it promises no error."""
    name = done.column("baseline")[0].as_py()
    if name not in BASELINES:
        return None
    promise = BASELINES[name].promise
    rows = done.to_pylist()
    if any(promise.count and row["points_decoded"] != row["points_in"] for row in rows):
        return False
    if promise.bound == "none":
        return None
    if promise.bound == "axis":
        return all(row["max_axis_error_m"] <= row["max_error"] + FLOAT32_SLACK for row in rows)
    return all(row["max_error_m"] <= row["max_error"] for row in rows) and all(
        row["bit_exact"] for row in rows if row["max_error"] == 0
    )


def _partly(rows: pa.Table) -> str:
    """Say how many scans failed, and why the first did."""
    reasons = [status for status in rows.column("status").to_pylist() if status != "ok"]
    return f"{len(reasons)} of {rows.num_rows} scans {reasons[0]}"


def _distinct(rows: pa.Table, column: str) -> list[Any]:
    """Distinct values of a column in the order of their first appearance."""
    return list(dict.fromkeys(rows.column(column).to_pylist()))
