"""Build the report of a run from what it measured: ``report.json``, tables, one page.

Reads ``OUT/report/*.parquet`` and ``run.json`` (see :mod:`salpcc.stages.evaluate.record`) and the sizes of
the files in ``OUT/archives/``; writes beside them ``report.json``, ``tables.md``, ``tables/NAME.parquet`` and
``index.html``. Nothing is decoded again, so it takes seconds.
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from salpcc.stages.evaluate.aggregate import STREAMS, figures, total
from salpcc.stages.evaluate.baseline_figures import baseline_figures, bd_rates
from salpcc.stages.evaluate.layout.comparison_plots import sequence_plots
from salpcc.stages.evaluate.layout.page import render_page
from salpcc.stages.evaluate.layout.pictures import Picture, scan_pictures
from salpcc.stages.evaluate.layout.plots import all_plots
from salpcc.stages.evaluate.layout.report_tables import all_tables
from salpcc.stages.evaluate.layout.tables import to_document
from salpcc.stages.evaluate.machine import describe_machine
from salpcc.stages.evaluate.record import recorded, recorded_run

REPORT_VERSION = 1
_PICTURED = 4  # sequences; more would only make the page heavy


def build(out: Path) -> dict[str, Any]:
    """Write the report of the run in ``out`` and return what ``report.json`` says.

    Raises:
        ShardError: the measurements are unreadable or of a newer version.
    """
    metrics = recorded(out, "metrics")
    report = collect(out, metrics)
    folder = out / "report"
    (folder / "tables").mkdir(parents=True, exist_ok=True)
    (folder / "report.json").write_text(json.dumps(report, indent=1, allow_nan=False) + "\n")
    tables = all_tables(report)
    for table in tables:
        pq.write_table(table.to_arrow(), folder / "tables" / f"{table.name}.parquet")
    (folder / "tables.md").write_text(to_document(tables))
    page = render_page(report, tables, all_plots(report), sequence_plots(report), _pictures(metrics))
    (folder / "index.html").write_text(page, encoding="utf-8")
    return report


def collect(out: Path, metrics: pa.Table) -> dict[str, Any]:
    """Put the figures of ``report.json`` together; anything not finite becomes null."""
    times, baselines = recorded(out, "times"), recorded(out, "baselines")
    sequences, containers = {}, 0
    for name in sorted(set(metrics.column("sequence").to_pylist())):
        rows = _of(metrics, name)
        container = container_bytes(out, name, rows)
        containers += container
        sequences[name] = figures(rows, _of(times, name), container)
        if baselines.num_rows:
            sequences[name]["baselines"] = baseline_figures(_of(baselines, name))
    compared = baseline_figures(baselines)
    report = {
        "version": REPORT_VERSION,
        "run": recorded_run(out),
        "machine": describe_machine(),
        "sequences": sequences,
        "total": figures(metrics, times, containers),
        "baselines": compared,
        "bd_rate_percent": bd_rates(compared),
        "failures": recorded(out, "failures").to_pylist(),
        "errors": error_lines(recorded(out, "failures")),
    }
    finite = _finite(report)
    assert isinstance(finite, dict)
    return finite


def error_lines(failures: pa.Table) -> list[dict[str, str]]:
    """Name what failed: sequence, scan (empty for a whole sequence), stage, reason."""
    return [
        {"sequence": row["sequence"], "scan": row["name"], "stage": row["stage"], "reason": row["message"]}
        for row in failures.to_pylist()
    ]


def container_bytes(out: Path, sequence: str, metrics: pa.Table) -> int:
    """Bytes of the sequence's archive that are not payload; 0 where the archive is not at hand."""
    path = out / "archives" / f"{sequence}.mcap"
    if not path.exists():
        return 0
    return max(0, path.stat().st_size - sum(total(metrics, f"bytes_{stream}") for stream in STREAMS))


def _of(rows: pa.Table, sequence: str) -> pa.Table:
    return rows.filter(pc.equal(rows.column("sequence"), sequence))


def _pictures(metrics: pa.Table) -> dict[str, list[Picture]]:
    """Pictures of the sample scans of the first few sequences."""
    samples = metrics.filter(pc.is_valid(metrics.column("sample_points"))).sort_by("sequence")
    pictures: dict[str, list[Picture]] = {}
    for row in range(min(samples.num_rows, _PICTURED)):
        sequence, name = (samples.column(key)[row].as_py() for key in ("sequence", "name"))
        points = samples.column("sample_points")[row].values.to_numpy().reshape(-1, 3)
        error = samples.column("sample_error_m")[row].values.to_numpy()
        classes = samples.column("sample_classes")[row]
        pictures[sequence] = scan_pictures(
            f"{sequence}/{name}", points, error, classes.values.to_numpy() if classes.is_valid else None
        )
    return pictures


def _finite(value: Any) -> Any:
    """Copy a JSON value with NaN and infinities as None: they are no JSON."""
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_finite(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
