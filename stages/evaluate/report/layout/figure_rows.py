"""Flatten the nested figures of ``report.json`` to one row of a table."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from salpcc.stages.evaluate.measures.aggregate import STREAMS

TOTAL = "all"


def rows_of(report: Mapping[str, Any]) -> tuple[dict[str, Any], ...]:
    """One flat row per sequence, then the total."""
    rows = [flat_row(name, figures) for name, figures in report["sequences"].items()]
    return (*rows, flat_row(TOTAL, report["total"]))


def flat_row(name: str, figures: Mapping[str, Any]) -> dict[str, Any]:
    """Flatten the nested figures of one sequence, errors in millimetres."""
    row = {"sequence": name, **{k: v for k, v in figures.items() if not isinstance(v, Mapping)}}
    for group, prefix in (("bpp", "bpp"), ("bytes", "bytes"), ("ms_per_scan", "ms")):
        row |= {f"{prefix}_{key}": value for key, value in (figures.get(group) or {}).items()}
    size = figures["bytes"]["total"] if figures.get("bytes") else None
    if size:
        row |= {f"share_{s}": 100.0 * (figures["bytes"].get(s) or 0) / size for s in STREAMS}
    iou = figures.get("iou") or {}
    row |= {f"group_{key}": value for key, value in (iou.get("groups") or {}).items()}
    row |= {f"bare_{key}": value for key, value in (iou.get("groups_without_terrain") or {}).items()}
    row |= {f"class_{key}": value for key, value in (iou.get("classes") or {}).items()}
    row |= {key: iou.get(key) for key in ("miou", "miou_paper", "movable_recall", "movable_precision")}
    for kind in ("max", "max_axis", "rms"):
        error = figures.get(f"{kind}_error_m")
        row[f"{kind}_error_mm"] = None if error is None else 1e3 * error
    return row
