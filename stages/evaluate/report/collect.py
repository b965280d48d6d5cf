"""Put the content of ``report.json`` together from what was recorded; its names are a contract (ARCHITECTURE.md)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc

from salpcc.schemas.errors import ArchiveError
from salpcc.stages.evaluate.measures.aggregate import STREAMS, figures, total
from salpcc.stages.evaluate.report.baseline_figures import baseline_figures, bd_rates
from salpcc.stages.evaluate.report.downstream import (
    ablation_figures,
    coder_figures,
    localisation_figures,
    registration_figures,
)
from salpcc.stages.evaluate.report.machine import describe_machine
from salpcc.stages.evaluate.report.record import recorded, recorded_run
from salpcc.stages.evaluate.report.savings import add_savings
from salpcc.stages.residual_code.archive.reader import ArchiveReader

REPORT_VERSION = 2


def collect(out: Path, beside: Sequence[Path] = ()) -> dict[str, Any]:
    """Return the figures of ``report.json``; anything not finite is None.

    Runs in the folders ``beside`` are shown next to the one in ``out``, and what only they recorded (baselines,
    registration, maps, coders, ablations) with it.
    """
    folders = [out, *beside]
    baselines = next((t for t in (recorded(f, "baselines") for f in folders) if t.num_rows), None)
    report = run_figures(out)
    others = [{"config": recorded_run(f).get("config", {}), **run_figures(f)} for f in beside]
    add_savings(report, recorded_run(out).get("config", {}), others)
    if baselines is not None:
        first = {name: f for run in (*reversed(others), report) for name, f in run["sequences"].items()}
        for name, sequence in first.items():
            sequence["baselines"] = baseline_figures(_of(baselines, name))
    compared = {} if baselines is None else baseline_figures(baselines)
    failures = recorded(out, "failures")
    report = {
        "version": REPORT_VERSION,
        "run": recorded_run(out),
        "machine": describe_machine(),
        **report,
        "beside": others,
        "baselines": compared,
        "bd_rate_percent": bd_rates(compared),
        "coders": coder_figures(_joined(folders, "coders")),
        "ablations": ablation_figures(_joined(folders, "ablations")),
        "registration": registration_figures(_joined(folders, "registration")),
        "localisation": localisation_figures(_joined(folders, "localisation")),
        "map_quality": sorted(_joined(folders, "map_quality").to_pylist(), key=_map_place),
        "failures": failures.to_pylist(),
        "errors": error_lines(failures),
    }
    finite = _finite(report)
    assert isinstance(finite, dict)
    return finite


def run_figures(out: Path) -> dict[str, Any]:
    """Figures of the run in ``out``: ``sequences`` and ``total``."""
    metrics, times = recorded(out, "metrics"), recorded(out, "times")
    sequences, containers = {}, 0
    for name in sorted(set(metrics.column("sequence").to_pylist())):
        rows = _of(metrics, name)
        archive = _archive(out, name)
        container = container_bytes(out / "archives" / f"{name}.mcap", archive, rows)
        containers += container
        sequences[name] = figures(rows, _of(times, name), container) | _side_figures(archive)
        (sequences[name]["iou"] or {}).pop("confusion", None)  # of all sequences together is enough
    return {"sequences": sequences, "total": figures(metrics, times, containers)}


def _archive(out: Path, sequence: str) -> ArchiveReader | None:
    """The archive of a sequence, where it is at hand and whole."""
    try:
        return ArchiveReader(out / "archives" / f"{sequence}.mcap")
    except ArchiveError:
        return None


def container_bytes(path: Path, archive: ArchiveReader | None, metrics: pa.Table) -> int:
    """Bytes of the sequence's archive that are for its points and not payload; 0 where the archive is not at hand."""
    if not path.exists():
        return 0
    other = sum(total(metrics, f"bytes_{stream}") for stream in STREAMS)
    if archive is not None:  # other topics of a log, labels and side files are nobody's points
        other += archive.passing_bytes + archive.labels_bytes + sum(archive.side.values())
    return max(0, path.stat().st_size - other)


def _side_figures(archive: ArchiveReader | None) -> dict[str, Any]:
    """Labels and side files that an archive holds; their bytes are in no other figure."""
    if archive is None:
        return {"labels": None, "side_files": None}
    scans = sum(entry.labels > 0 for gop in archive.gops for entry in gop)
    return {
        "labels": {"scans": scans, "bytes": archive.labels_bytes},
        "side_files": {"files": len(archive.side), "bytes": sum(archive.side.values())},
    }


def error_lines(failures: pa.Table) -> list[dict[str, str]]:
    """Name what failed: sequence, scan (empty for a whole sequence), stage, reason."""
    return [
        {"sequence": row["sequence"], "scan": row["name"], "stage": row["stage"], "reason": row["message"]}
        for row in failures.to_pylist()
    ]


def _map_place(row: dict[str, Any]) -> tuple[str, str]:
    """By sequence and kind of truth, otherwise as recorded."""
    return row["sequence"] or "", row["truth"] or ""


def _joined(folders: Sequence[Path], name: str) -> pa.Table:
    """All rows that the folders recorded under a name."""
    return pa.concat_tables([recorded(folder, name).replace_schema_metadata(None) for folder in folders])


def _of(rows: pa.Table, sequence: str) -> pa.Table:
    return rows.filter(pc.equal(rows.column("sequence"), sequence))


def _finite(value: Any) -> Any:
    """Copy a JSON value with NaN and infinities as None: they are no JSON."""
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_finite(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
