"""Build the report of a run from what was measured: ``report.json``, tables, one page.

Reads ``OUT/report/*.parquet`` and ``run.json`` (see :mod:`salpcc.stages.evaluate.report.record`) and the sizes of
the files in ``OUT/archives/``; writes beside them ``report.json``, ``tables.md``, ``tables/NAME.parquet`` and
``index.html``. Nothing is decoded again, so it takes seconds.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from salpcc.schemas.files import atomic
from salpcc.stages.evaluate.report.collect import collect
from salpcc.stages.evaluate.report.layout.gallery import galleries
from salpcc.stages.evaluate.report.layout.page import render_page
from salpcc.stages.evaluate.report.layout.paper_tables import published_tables
from salpcc.stages.evaluate.report.layout.report_tables import all_tables
from salpcc.stages.evaluate.report.layout.scene import scene_of
from salpcc.stages.evaluate.report.layout.tables import to_document
from salpcc.stages.evaluate.report.record import recorded


def build(out: Path, beside: Sequence[Path] = (), paper: bool = False) -> dict[str, Any]:
    """Write the report of the run in ``out``, with those ``beside`` it, and return what ``report.json`` says.

    Args:
        paper: show the paper's published tables on the page, too, and what of them is not measured.

    Raises:
        ShardError: the measurements are unreadable or of a newer version.
    """
    report = collect(out, beside)
    folder = out / "report"
    (folder / "tables").mkdir(parents=True, exist_ok=True)
    (folder / "report.json").write_text(json.dumps(report, indent=1, allow_nan=False) + "\n")
    tables = [*all_tables(report), *published_tables()]
    for table in tables:
        with atomic(folder / "tables" / f"{table.name}.parquet") as stream:
            pq.write_table(table.to_arrow(), stream)
    (folder / "tables.md").write_text(to_document(tables))
    drawn = pa.concat_tables([recorded(f, "pictures").replace_schema_metadata(None) for f in (out, *beside)])
    metrics = recorded(out, "metrics")
    page = render_page(report, galleries(metrics, drawn), scene_of(metrics), paper)
    (folder / "index.html").write_text(page, encoding="utf-8")
    return report
