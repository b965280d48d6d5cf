"""Tables II, III and IV: rates and times in the paper's own terms, measured, and as published."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from salpcc.stages.evaluate.report.layout import published
from salpcc.stages.evaluate.report.layout.runs import Run, accuracy_label, all_runs
from salpcc.stages.evaluate.report.layout.tables import Column, Table

Report = Mapping[str, Any]
_EQUAL_ERROR = "0.01"  # metres, as the record names it; the error at which times are compared


def paper_tables(report: Report) -> list[Table]:
    """Tables II to IV as far as they were measured."""
    runs = all_runs(report)
    tables = []
    if any(run.of_paper for run in runs):
        tables += [table_2(report, runs), stage_table(runs)]
    if report["baselines"]:
        tables.append(table_3(report, runs))
    return tables


def published_tables() -> list[Table]:
    """Tables II, IV and V as the paper has them."""
    note = "The paper's figures, on its sequences and machine; not measured here."
    rates = [Column("sequence", "sequence")]
    for system in ("SA-LPCC", "octree"):
        rates += [
            Column(f"{system}{a}", f"{system}, {accuracy_label(a)}", ".2f") for a in published.ACCURACIES
        ]
    times = [Column("sequence", "sequence"), *(Column(name, f"{name}, s", ".3f") for name in published.PARTS)]
    pairs = (
        Column("pair", "pair of sequence 20"),
        Column("cloud", "cloud"),
        Column("rotation_deg", "rotation error, deg", ".4f"),
        Column("translation_m", "translation error, m", ".4f"),
    )
    found = [row._asdict() | {"pair": f"{row.source}, {row.target}"} for row in published.REGISTRATION]
    return [
        Table(
            "published2", "Table II as published: CR, %", tuple(rates), _rows(rates, published.RATES), note
        ),
        Table("published4", "Table IV as published", tuple(times), _rows(times, published.STAGE_TIMES), note),
        Table("published5", "Table V as published", pairs, tuple(found), note, grouped="pair"),
    ]


def table_2(report: Report, runs: list[Run]) -> Table:
    """CR of geometry by sequence: every run, and octree; below, what the grid loses and how far points move."""
    runs = sorted(runs, key=lambda run: (not run.of_paper, run.system, run.accuracy))
    columns = [
        Column("sequence", "sequence"),
        *(Column(f"run{i}", r.label, ".2f") for i, r in enumerate(runs)),
    ]
    octree = [a for a in published.ACCURACIES if f"{a:g}" in report["baselines"].get("octree", {})]
    columns += [Column(f"octree{a:g}", f"octree, {accuracy_label(a)}", ".2f") for a in octree]
    names = sorted({name for run in runs for name in run.sequences})
    compared = {name: f["baselines"] for run in runs for name, f in run.sequences.items() if "baselines" in f}
    compared["all"] = report["baselines"]
    rows: list[dict[str, Any]] = []
    for name in [*names, "all"]:
        row: dict[str, Any] = {"sequence": name}
        for i, run in enumerate(runs):
            figures = run.total if name == "all" else run.sequences.get(name)
            row[f"run{i}"] = figures and figures["geometry_rate_percent"]
        for a in octree:
            measured = compared.get(name, {}).get("octree", {}).get(f"{a:g}") or {}
            row[f"octree{a:g}"] = measured.get("geometry_rate_percent")
        rows.append(row)
    for heading, measure in _BELOW.items():
        rows.append({"sequence": heading, **{f"run{i}": measure(run.total) for i, run in enumerate(runs)}})
    note = (
        "CR, eq. (23), of geometry: all bytes that x, y, z need, over 16 bytes per input point, movable points "
        "dropped as each run says; octree codes them too. The accuracy of the paper's grid is its step of ranges, "
        "that of the others bounds the error. Lost: points kept by the task that share a cell with a nearer one. "
        "Errors: of the points that come back, each to its own source point."
    )
    return Table("table2", "Rates in the paper's terms (Table II)", tuple(columns), tuple(rows), note)


def table_3(report: Report, runs: list[Run]) -> Table:
    """Seconds a scan of every system, published and measured."""
    columns = (
        Column("system", "system"),
        Column("encode_published", "encode, s (published)", ".3f"),
        Column("decode_published", "decode, s (published)", ".3f"),
        Column("encode", "encode, s", ".3f"),
        Column("decode", "decode, s", ".3f"),
    )
    rows = []
    for system, name, encode, decode in published.TIMES:
        measured = report["baselines"].get(name, {}).get(_EQUAL_ERROR) or {}
        if name is None:
            measured = next((run.total for run in runs if run.of_paper), {})
        rows.append(
            {"system": system, "encode_published": encode, "decode_published": decode, **_seconds(measured)}
        )
    rows += [{"system": run.label, **_seconds(run.total)} for run in runs]
    note = (
        "Published: the paper's Table III, on its machine with a GPU. Measured: CPU of one core, baselines at 10 mm; "
        "a run of this pipeline with all its stages, reading included. SA-LPCC, measured: the run of the paper's "
        "profile shown here."
    )
    return Table("table3", "Times (Table III)", columns, tuple(rows), note)


def stage_table(runs: list[Run]) -> Table:
    """Seconds a scan of each part, by sequence: runs of the paper's profile."""
    columns = (
        Column("sequence", "sequence"),
        Column("system", "system"),
        *(Column(name, f"{name}, s", ".3f") for name in published.PARTS),
    )
    rows = []
    for run in runs:
        if run.of_paper:
            for name, figures in [*run.sequences.items(), ("all", run.total)]:
                ms = {**figures["ms_per_scan"], "decode": figures["decode_ms_per_scan"]}
                seconds = {part: _over(ms.get(stage), 1e3) for part, stage in published.PARTS.items()}
                rows.append({"system": run.label, "sequence": name, **seconds})
    note = "CPU of one core, median a scan. Data processing: reading and projection."
    return Table("table4", "Time of each part (Table IV)", columns, tuple(rows), note, grouped="system")


_BELOW = {
    "lost, %": lambda f: _over(
        100.0 * f["points_lost"], f["points_in"] - f["points_dropped_movable"] or None
    ),
    "largest error, mm": lambda f: _over(f["max_error_m"], 1e-3),
    "RMS error, mm": lambda f: _over(f["rms_error_m"], 1e-3),
}


def _seconds(figures: Mapping[str, Any]) -> dict[str, float | None]:
    return {
        "encode": _over(figures.get("encode_ms_per_scan"), 1e3),
        "decode": _over(figures.get("decode_ms_per_scan"), 1e3),
    }


def _over(value: float | None, unit: float | None) -> float | None:
    return None if value is None or unit is None else value / unit


def _rows(columns: list[Column], data: Mapping[str, tuple[float, ...]]) -> tuple[dict[str, Any], ...]:
    keys = [column.key for column in columns]
    return tuple(dict(zip(keys, (name, *values), strict=True)) for name, values in data.items())
