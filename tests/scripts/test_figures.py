"""The page of figures come from report.json, between markers, and nothing else changes."""

from __future__ import annotations

import json
from pathlib import Path
from types import ModuleType

import numpy as np
import pyarrow as pa
import pytest

from salpcc.schemas.scan import Scan
from salpcc.stages.evaluate.baselines import BASELINES as CODECS
from salpcc.stages.evaluate.baselines.measure_baseline import measure
from salpcc.stages.evaluate.report import write as report
from salpcc.stages.evaluate.report.record import record
from salpcc.stages.evaluate.report.schema import BASELINES, METRICS


@pytest.fixture
def out(tmp_path: Path) -> Path:
    counts = {f.name: 0 for f in METRICS if pa.types.is_integer(f.type)}
    row = counts | {"sequence": "00", "name": "000000", "points_in": 1000, "bytes_geometry": 875}
    cloud = np.random.default_rng(0).uniform(-20, 20, (1000, 3)).astype(np.float32)
    scan = Scan("000000", cloud, np.zeros(1000, np.float32))
    coded = measure("laszip", CODECS["laszip"], [scan], "00", 0.01)
    record(
        tmp_path,
        {"command": ["run", "it"]},
        metrics=pa.Table.from_pylist([row], schema=METRICS),
        baselines=pa.Table.from_pylist(coded, schema=BASELINES),
    )
    report.build(tmp_path)
    return tmp_path


def test_blocks_are_filled_and_the_rest_stays(script: ModuleType, out: Path, tmp_path: Path) -> None:
    page = tmp_path / "figures.md"
    page.write_text("# Title\n<!-- figures:begin sequences -->\nold 9.99\n<!-- figures:end -->\nend\n")
    assert script.main([str(out), "--page", str(page), "--check"]) == 1
    assert script.main([str(out), "--page", str(page)]) == 0
    text = page.read_text()
    assert text.startswith("# Title\n") and text.endswith("<!-- figures:end -->\nend\n")
    assert "9.99" not in text and "| 00 | 1 | 1,000 | 7.00 |" in text and "`run it`" in text
    assert script.main([str(out), "--page", str(page), "--check"]) == 0


def test_figures_that_were_typed_are_noticed(script: ModuleType, out: Path, tmp_path: Path) -> None:
    page = tmp_path / "figures.md"
    page.write_text("<!-- figures:begin bytes -->\n<!-- figures:end -->\n")
    script.main([str(out), "--page", str(page)])
    page.write_text(page.read_text().replace("875", "874"))
    assert script.main([str(out), "--page", str(page), "--check"]) == 1


def test_a_plot_is_drawn_beside_the_readme(script: ModuleType, out: Path, tmp_path: Path) -> None:
    page, name = tmp_path / "figures.md", "rate_against_the_promised_error"
    page.write_text(f"<!-- figures:begin {name} -->\n<!-- figures:end -->\n")
    assert script.main([str(out), "--page", str(page)]) == 0
    drawn = tmp_path / f"{name}.svg"
    assert f"]({name}.svg)" in page.read_text() and "laszip" in drawn.read_text()
    assert script.main([str(out), "--page", str(page), "--check"]) == 0
    drawn.write_text(drawn.read_text().replace("laszip", "zip"))
    assert script.main([str(out), "--page", str(page), "--check"]) == 1


def test_an_unknown_table_is_refused(script: ModuleType, out: Path) -> None:
    figures = json.loads((out / "report" / "report.json").read_text())
    with pytest.raises(ValueError, match="plot 'mood'"):
        script.fill("<!-- figures:begin mood -->\n<!-- figures:end -->", [figures])
