"""Run what was asked for, and show what it gave."""

from __future__ import annotations

import sys
import time
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from salpcc.pipeline.cli.summary import summary
from salpcc.pipeline.schedule.progress import STDERR

if TYPE_CHECKING:
    from salpcc.pipeline.run import RunRequest, RunResult


def execute(request: RunRequest, json_: bool) -> None:
    """Run, print what it gave, leave with its exit code."""
    from salpcc.pipeline.run import run_sequences
    from salpcc.stages.ingest.sources import SOURCES

    start = time.monotonic()
    result = run_sequences(request)
    if SOURCES[request.config.source].passes:
        _tell_passed(result)
    _show(result, request.out, json_, request.sequences, time.monotonic() - start)
    raise typer.Exit(1 if result.failed else 0)


def _tell_passed(result: RunResult) -> None:
    """Say what became of the clouds of a log that failed: they pass through, where there is an archive."""
    written = result.report["sequences"] if result.report else {}
    for name, count in Counter(error.sequence for error in result.errors if error.scan).items():
        if name in written:
            STDERR.print(
                f"note: {name}: {count} that failed are in the archive as they were recorded", soft_wrap=True
            )


def _show(result: RunResult, out: Path, json_: bool, names: list[str], seconds: float) -> None:
    """Print what a run of the sequences ``names`` gave."""
    for error in result.errors:
        STDERR.print(f"failed: {error.sequence}/{error.scan}: {error.reason}", soft_wrap=True)
    if result.report is None:
        STDERR.print(f"stopped as asked; shards are in {out / 'shards'}", soft_wrap=True)
        return
    if json_:
        sys.stdout.write((out / "report" / "report.json").read_text())
        return
    console = Console(emoji=False, markup=False)
    table = Table(title="bits per input point", box=SIMPLE_HEAD, padding=(0, 1, 0, 0), title_justify="left")
    for column in (
        "sequence",
        "scans",
        "points",
        "geom.",
        "intens.",
        "total",
        "% raw",
        "max error",
        "fallback",
    ):
        table.add_column(column, justify="left" if column == "sequence" else "right", overflow="fold")
    for name, figures in result.report["sequences"].items():
        table.add_row(name, *_cells(figures))
    console.print(table)
    mine = [figures for name, figures in result.report["sequences"].items() if name in names]
    for line in summary(mine, seconds):
        console.print(line, highlight=False, soft_wrap=True)
    console.print(f"archives: {out / 'archives'}\nreport: {out / 'report' / 'index.html'}", soft_wrap=True)


def _cells(figures: dict[str, Any]) -> list[str]:
    bpp, sizes, source = figures["bpp"], figures["bytes"], figures["bytes_source"]
    error = figures["max_error_m"]
    return [
        str(figures["frames"]),
        str(figures["points_in"]),
        *(f"{bpp[key]:.2f}" if bpp[key] is not None else "-" for key in ("geometry", "intensity", "total")),
        f"{100 * sizes['total'] / source:.2f}" if source else "-",
        "exact" if error == 0 else "-" if error is None else f"{1e3 * error:.2f} mm",
        str(figures["points_on_fallback"]),
    ]
