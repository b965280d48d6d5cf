"""Fill the tables and plots of docs/figures.md from what was measured: ``python scripts/figures.py OUT… --bench BENCH.json``.

A table stands between ``<!-- figures:begin NAME -->`` and ``<!-- figures:end -->``, where NAME is any table of the
report in OUT (``sequences``, ``times``, ``table1``, ``groups``, ``baselines``, ``bd_rate``, ``table2`` to ``table5``,
``fig8``, ``map``, ``ablation1`` …), or ``bench``, which ``python -m salpcc.stages.evaluate.studies.bench --json BENCH.json`` measures.
A plot's NAME is its title in lower case with ``_`` for spaces (``rate_against_the_promised_error``); it is written
beside the page. With several OUTs a block comes from the first that has it. Nothing between the markers is ever typed.
With ``--check`` no file is changed and the exit code is 1 where one differs. Blocks of a source that is not named are left
alone.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from salpcc.stages.evaluate.report.layout.comparison_plots import comparison_plots
from salpcc.stages.evaluate.report.layout.report_tables import all_tables
from salpcc.stages.evaluate.report.layout.tables import Column, Table

BLOCK = re.compile(r"(<!-- figures:begin (\w+) -->\n).*?(<!-- figures:end -->)", re.DOTALL)
BENCH = "bench"


def fill(text: str, reports: Sequence[Mapping[str, Any]], bench: Mapping[str, Any] | None = None) -> str:
    """Return the text with the marked blocks replaced.

    Raises:
        ValueError: a block names a table that the report does not have, or there is none for the bench.
    """
    tables: dict[str, str] = {}
    for report in reversed(reports):
        for table in all_tables(report):
            tables[table.name] = f"{table.to_markdown()}\n\n{table.note} {provenance(report)}"
    tables |= {name: shown for name, (shown, _) in plots(reports).items()}
    if bench is not None:
        tables[BENCH] = bench_table(bench)
        if BENCH not in {match[2] for match in BLOCK.finditer(text)}:
            raise ValueError("no block <!-- figures:begin bench --> … <!-- figures:end -->")

    def block(match: re.Match[str]) -> str:
        name = match[2]
        if name in tables:
            return f"{match[1]}\n{tables[name]}\n\n{match[3]}"
        if not (bench if name == BENCH else reports):
            return match[0]
        raise ValueError(f"no report has a table or plot {name!r}, only {', '.join(sorted(tables))}")

    return BLOCK.sub(block, text)


def plots(reports: Sequence[Mapping[str, Any]]) -> dict[str, tuple[str, str]]:
    """Return by name what stands on the page for each plot, and its SVG."""
    found: dict[str, tuple[str, str]] = {}
    for report in reversed(reports):
        for plot in comparison_plots(report):
            name = plot.title.lower().replace(" ", "_")
            link = f"![{plot.title}]({name}.svg)"
            # On a page of its own it needs a size, and a ground that its dark text can be read on.
            svg = plot.svg.replace("<svg ", '<svg width="640" style="background: #fff" ', 1)
            found[name] = f"{link}\n\n{plot.caption} {provenance(report)}", svg
    return found


def provenance(report: Mapping[str, Any]) -> str:
    """Say where the figures come from, in one sentence."""
    run, machine = report["run"], report["machine"]
    command = run.get("command") or "a run"
    command = command if isinstance(command, str) else " ".join(command)
    version = run.get("tool_version", "")
    return f"Measured by `{command}` ({version}) on {machine['cores']} cores of {machine['processor']}."


def bench_table(bench: Mapping[str, Any]) -> str:
    """Lay the bench out, with a sentence on how it was measured."""
    columns = (
        Column("asked", "asked error"),
        Column("codec", "codec"),
        Column("bpp_geometry", "geometry, bpp", ".2f"),
        Column("bpp_total", "total, bpp", ".2f"),
        Column("max_error", "max error, mm", ".3f"),
        Column("encode_ms", "encode, ms", ".0f"),
        Column("decode_ms", "decode, ms", ".0f"),
    )
    rows = tuple(
        {
            **row,
            "asked": f"{1e3 * row['max_error']:g} mm" if row["max_error"] else "bit-exact",
            "max_error": None if row["max_error_m"] is None else 1e3 * row["max_error_m"],
        }
        for row in bench["rows"]
    )
    words = list(bench["command"])
    if "--json" in words:  # where the figures went says nothing
        del words[words.index("--json") : words.index("--json") + 2]
    note = (
        f"{bench['scans']} scans, {bench['points']:,} points, median of {bench['rounds']} rounds in turns, CPU ms "
        f"a scan on one core of {bench['machine']['processor']}, by `{' '.join(words)}`. A dash: the codec keeps no "
        "order, so no point's error is known; or not all points. Bits are per point of the scans, all of them."
    )
    return f"{Table(BENCH, 'Bench', columns, rows).to_markdown()}\n\n{note}"


def main(arguments: Sequence[str] | None = None) -> int:
    """Fill, or check, the page."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("out", type=Path, nargs="*", help="output folders of runs")
    parser.add_argument("--bench", type=Path, help="what the bench wrote with --json")
    parser.add_argument("--page", type=Path, default=Path(__file__).parents[1] / "docs" / "figures.md")
    parser.add_argument("--check", action="store_true")
    asked = parser.parse_args(arguments)
    before = asked.page.read_text(encoding="utf-8")
    reports = [json.loads((out / "report" / "report.json").read_text()) for out in asked.out]
    bench = None if asked.bench is None else json.loads(asked.bench.read_text())
    try:
        after = fill(before, reports, bench)
    except ValueError as error:
        print(f"figures: {error}", file=sys.stderr)
        return 2
    docs = asked.page.parent
    used = {match[2] for match in BLOCK.finditer(after)}
    files = {docs / f"{name}.svg": svg for name, (_, svg) in plots(reports).items() if name in used}
    files[asked.page] = after
    if asked.check:
        return int(any(not path.is_file() or path.read_text() != new for path, new in files.items()))
    for path, new in files.items():
        path.parent.mkdir(exist_ok=True)
        path.write_text(new, encoding="utf-8")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
