"""Fill the bench table of README.md from what the bench measured: ``python scripts/readme_bench.py BENCH.json``.

``python -m salpcc.stages.evaluate.bench --json BENCH.json`` makes that file. The table stands between
``<!-- bench:begin -->`` and ``<!-- bench:end -->``; nothing there is ever typed. With ``--check`` the file is
left alone and the exit code is 1 where it differs.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from salpcc.stages.evaluate.layout.tables import Column, Table

BLOCK = re.compile(r"(<!-- bench:begin -->\n).*?(<!-- bench:end -->)", re.DOTALL)
COLUMNS = (
    Column("asked", "asked error"),
    Column("codec", "codec"),
    Column("bpp_geometry", "geometry, bpp", ".2f"),
    Column("bpp_total", "total, bpp", ".2f"),
    Column("max_error", "max error, mm", ".3f"),
    Column("encode_ms", "encode, ms", ".0f"),
    Column("decode_ms", "decode, ms", ".0f"),
)


def fill(text: str, bench: Mapping[str, Any]) -> str:
    """Return the text with the marked block replaced.

    Raises:
        ValueError: the text has no such block.
    """
    rows = tuple(_row(row) for row in bench["rows"])
    note = (
        f"{bench['scans']} scans, {bench['points']:,} points, median of {bench['rounds']} rounds in turns, CPU ms "
        f"a scan on one core of {bench['machine']['processor']}, by `{_command(bench)}`. A dash: the codec keeps no "
        "order, so no point's error is known."
    )
    table = Table("bench", "Bench", COLUMNS, rows).to_markdown()
    filled, count = BLOCK.subn(lambda match: f"{match[1]}\n{table}\n\n{note}\n\n{match[2]}", text)
    if not count:
        raise ValueError("no block <!-- bench:begin --> … <!-- bench:end -->")
    return filled


def _row(row: Mapping[str, Any]) -> dict[str, Any]:
    error = row["max_error_m"]
    return {
        **row,
        "asked": f"{1e3 * row['max_error']:g} mm" if row["max_error"] else "bit-exact",
        "max_error": None if error is None else 1e3 * error,
    }


def _command(bench: Mapping[str, Any]) -> str:
    """The command without where its figures went."""
    words = list(bench["command"])
    if "--json" in words:
        del words[words.index("--json") : words.index("--json") + 2]
    return " ".join(words)


def main(arguments: Sequence[str] | None = None) -> int:
    """Fill, or check, a README."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("bench", type=Path, help="what the bench wrote with --json")
    parser.add_argument("--readme", type=Path, default=Path(__file__).parents[1] / "README.md")
    parser.add_argument("--check", action="store_true")
    asked = parser.parse_args(arguments)
    before = asked.readme.read_text(encoding="utf-8")
    try:
        after = fill(before, json.loads(asked.bench.read_text()))
    except ValueError as error:
        print(f"readme_bench: {error}", file=sys.stderr)
        return 2
    if asked.check:
        return int(after != before)
    asked.readme.write_text(after, encoding="utf-8")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
