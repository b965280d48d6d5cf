"""Fill the tables of README.md from a run's report.json: ``python scripts/readme_figures.py OUT``.

A table stands between ``<!-- figures:begin NAME -->`` and ``<!-- figures:end -->``, where NAME is ``summary`` or
any table of the report (``sequences``, ``bytes``, ``times``, ``iou``, ``baselines``, ``published``). Nothing
between the markers is ever typed. With ``--check`` the file is left alone and the exit code is 1 where it
differs from the report.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from salpcc.stages.evaluate.layout.report_tables import all_tables, summary_table

BLOCK = re.compile(r"(<!-- figures:begin (\w+) -->\n).*?(<!-- figures:end -->)", re.DOTALL)


def fill(text: str, report: Mapping[str, Any]) -> str:
    """Return the text with every marked block replaced.

    Raises:
        ValueError: a block names a table that the report does not have.
    """
    tables = {table.name: table for table in [summary_table(report), *all_tables(report)]}

    def block(match: re.Match[str]) -> str:
        name = match[2]
        if name not in tables:
            raise ValueError(f"the report has no table {name!r}, only {', '.join(sorted(tables))}")
        table = tables[name]
        return f"{match[1]}\n{table.to_markdown()}\n\n{table.note} {provenance(report)}\n\n{match[3]}"

    return BLOCK.sub(block, text)


def provenance(report: Mapping[str, Any]) -> str:
    """Say where the figures come from, in one sentence."""
    run, machine = report["run"], report["machine"]
    command = run.get("command") or "a run"
    command = command if isinstance(command, str) else " ".join(command)
    version = run.get("tool_version", "")
    return f"Measured by `{command}` ({version}) on {machine['cores']} cores of {machine['processor']}."


def main(arguments: Sequence[str] | None = None) -> int:
    """Fill, or check, a README."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("out", type=Path, help="output folder of a run")
    parser.add_argument("--readme", type=Path, default=Path(__file__).parents[1] / "README.md")
    parser.add_argument("--check", action="store_true")
    asked = parser.parse_args(arguments)
    report = json.loads((asked.out / "report" / "report.json").read_text())
    before = asked.readme.read_text(encoding="utf-8")
    try:
        after = fill(before, report)
    except ValueError as error:
        print(f"readme_figures: {error}", file=sys.stderr)
        return 2
    if asked.check:
        return int(after != before)
    asked.readme.write_text(after, encoding="utf-8")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
