"""Sum up what other commands record for the report: registration, lossless coders, ablations."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyarrow as pa

from salpcc.stages.evaluate.measures.metrics import compression_rate

Rows = list[dict[str, Any]]

_IN_MAP = ("sequence", "map", "max_error", "movable", "method")
_LOST = 1.0  # metres, beyond which a scan was not found
_CLOUD = ("sequence", "method", "cloud", "max_error", "movable")


def registration_figures(rows: pa.Table) -> Rows:
    """Mean, standard deviation and median over the pairs of each sequence, method and cloud."""
    errors = {"rotation_deg": "rotation_deg", "translation_m": "translation_m"}
    wanted = [(key, how) for key in errors for how in ("mean", "stddev", "approximate_median")]
    grouped = rows.group_by(list(_CLOUD), use_threads=False).aggregate(
        [*wanted, ("bpp", "mean"), ("source", "count")]
    )
    names = {f"{key}_{how}": f"{key}_{short}" for key in errors for how, short in _SHORT.items()}
    names |= {"bpp_mean": "bpp", "source_count": "pairs"}
    found = [{names.get(key, key): value for key, value in row.items()} for row in grouped.to_pylist()]
    return sorted(
        found, key=lambda row: (row["sequence"] or "", row["method"] or "")
    )  # otherwise as recorded


def localisation_figures(rows: pa.Table) -> Rows:
    """Mean, standard deviation and median over the scans that were found in each map, within a metre, and how many were not."""
    by: dict[tuple[Any, ...], list[dict[str, Any]]] = {}
    for row in rows.to_pylist():
        by.setdefault(tuple(row[name] for name in _IN_MAP), []).append(row)
    found = []
    for key, group in by.items():
        good = [row for row in group if row["translation_m"] is not None and row["translation_m"] <= _LOST]
        figures = dict(zip(_IN_MAP, key, strict=True)) | {"scans": len(group), "lost": len(group) - len(good)}
        for name in ("rotation_deg", "translation_m"):
            values = np.array([row[name] for row in good])
            for short, measure in (("mean", np.mean), ("std", np.std), ("median", np.median)):
                figures[f"{name}_{short}"] = float(measure(values)) if len(values) else None
        found.append(figures)
    return found


def coder_figures(rows: pa.Table) -> Rows:
    """CR of each coder and input over all sequences, and CPU milliseconds a million points; the best first."""
    keys = ["input", "max_error", "coder", "settings", "status"]
    sums = ("points", "bytes_out", "encode_ms", "decode_ms")
    found = []
    for row in rows.group_by(keys, use_threads=False).aggregate([(name, "sum") for name in sums]).to_pylist():
        total = {name: row[f"{name}_sum"] for name in sums}
        ran = row["status"] == "ok" and total["points"]
        figures = {key: row[key] for key in keys} | {name: total[name] for name in sums[:2]}
        figures["rate_percent"] = compression_rate(total["bytes_out"], total["points"]) if ran else None
        for name in ("encode_ms", "decode_ms"):
            figures[name] = 1e6 * total[name] / total["points"] if ran and total[name] is not None else None
        found.append(figures)
    return sorted(found, key=_coder_place)


def ablation_figures(rows: pa.Table) -> dict[str, Rows]:
    """One row per sequence and variant of each study, its measures as keys."""
    studies: dict[str, dict[tuple[str, str], dict[str, Any]]] = {}
    for row in rows.to_pylist():
        study = studies.setdefault(row["study"], {})
        key = (row["sequence"], row["variant"])
        study.setdefault(key, {"sequence": key[0], "variant": key[1]})[row["measure"]] = row["value"]
    return {study: list(found.values()) for study, found in studies.items()}


_SHORT = {"mean": "mean", "stddev": "std", "approximate_median": "median"}


def _coder_place(figures: dict[str, Any]) -> tuple[bool, float, float]:
    rate = figures["rate_percent"]
    return figures["input"] == "raw", figures["max_error"] or 0.0, 1e9 if rate is None else rate
