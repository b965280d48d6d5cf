"""The report: the names of the contract, sums that add up, a page that stands alone."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from matplotlib.image import imread

from salpcc.schemas.errors import ShardError
from salpcc.schemas.scan import Scan
from salpcc.stages.evaluate import stage
from salpcc.stages.evaluate.baselines import BASELINES
from salpcc.stages.evaluate.baselines.measure_baseline import measure
from salpcc.stages.evaluate.report import write as report
from salpcc.stages.evaluate.report.layout.comparison_plots import _front
from salpcc.stages.evaluate.report.record import record, recorded
from salpcc.stages.evaluate.report.schema import BASELINES as BASELINES_SCHEMA
from salpcc.stages.evaluate.report.schema import FAILURES, TIMES

FRAMING = 5000


@pytest.fixture
def out(
    tmp_path: Path,
    street: Callable[..., Scan],
    without_movable: Callable[[Scan], Scan],
    payload_rows: Callable[[list[Scan], list[Scan]], pa.Table],
) -> Path:
    """A run of two sequences: 00 bit-exact but for its dropped car, 04 one point off by 30 mm."""
    tables = []
    for sequence in ("00", "04"):
        sources = [street("000000"), street("000001", seed=1)]
        decoded = [without_movable(scan) for scan in sources]
        if sequence == "04":
            points = decoded[0].points.copy()
            points[0, 0] += np.float32(0.03)
            decoded[0] = replace(decoded[0], points=points)
        payloads = payload_rows(sources, decoded)
        tables.append(
            stage.run(decoded, sources, payloads, sequence=sequence, gop=0, max_error=0.05, sample=True)
        )
        archive = tmp_path / "archives" / f"{sequence}.mcap"
        archive.parent.mkdir(exist_ok=True)
        archive.write_bytes(bytes(2 * 1670 + FRAMING))
    times = [
        {"sequence": s, "gop": 0, "stage": name, "scans": 2, "cpu_ms": 2.0 * ms, "wall_ms": 2.0 * ms}
        for s in ("00", "04")
        for name, ms in (("ingest", 100), ("residual_code", 50), ("evaluate", 400))
    ]
    failures = [
        {"sequence": "04", "name": "000002", "stage": "ingest", "file": "a<b>.bin", "message": "cut | off"}
    ]
    asked = (("xz", 0.0), ("octree", 0.01))
    coded = [row for name, e in asked for row in measure(name, BASELINES[name], [street()], "00", e)]
    absent = {"baseline": "tmc13", "sequence": "00", "name": "000000", "status": "not run: tmc3 not found"}
    coded += [absent | {"max_error": error, "points_in": 3000} for error in (0.001, 0.01)]
    record(
        tmp_path,
        {
            "command": ["salpcc-pipeline", "run"],
            "finished": "2026-11-22T01:30:05+00:00",
            "config": {"max_error": 0.05},
            "notes": ["a note"],
        },
        metrics=pa.concat_tables(tables),
        times=pa.Table.from_pylist(times, schema=TIMES),
        failures=pa.Table.from_pylist(failures, schema=FAILURES),
        baselines=pa.Table.from_pylist(coded, schema=BASELINES_SCHEMA),
    )
    return tmp_path


def test_every_name_of_the_contract_is_there(out: Path) -> None:
    report.build(out)
    figures = json.loads((out / "report" / "report.json").read_text())["sequences"]["00"]
    plain = (
        "frames points_in points_kept points_dropped_movable points_decoded points_on_fallback "
        "points_bit_identical compression_rate_percent geometry_rate_percent max_error_m rms_error_m d_d bit_exact_scans "
        "ms_per_scan encode_ms_per_scan decode_ms_per_scan"
    )
    assert all(figures[name] is not None for name in plain.split())
    assert figures["bytes"].keys() == {"geometry", "intensity", "classes", "side", "total"}
    assert figures["bpp"].keys() == {"geometry", "intensity", "total"}
    assert figures["iou"]["groups"] == {"movable": 1.0, "ground": 1.0, "other": 1.0}
    assert "miou" in figures["iou"] and "classes" in figures["iou"]


def test_the_figures_add_up(out: Path) -> None:
    built = report.build(out)
    exact, moved = built["sequences"]["00"], built["sequences"]["04"]
    assert exact["frames"] == 2 and exact["points_in"] == 6000
    assert exact["points_dropped_movable"] + exact["points_decoded"] == exact["points_in"]
    assert exact["points_lost"] == 0
    assert exact["bytes"] == {
        "geometry": 2000,
        "intensity": 1200,
        "classes": 100,
        "side": 40 + FRAMING,
        "total": 3340 + FRAMING,
    }
    assert exact["bpp"]["geometry"] == pytest.approx(8 * 2000 / 6000)
    assert exact["compression_rate_percent"] == pytest.approx(100 * (3340 + FRAMING) / (16 * 6000))
    assert exact["bit_exact_scans"] == 2 and exact["max_error_m"] == 0.0
    assert moved["bit_exact_scans"] == 1
    assert moved["max_error_m"] == pytest.approx(0.03, abs=1e-5)
    assert moved["rms_error_m"] == pytest.approx(0.03 / np.sqrt(moved["points_decoded"]), rel=1e-3)
    assert exact["ms_per_scan"] == {"ingest": 100.0, "residual_code": 50.0, "evaluate": 400.0}
    assert exact["encode_ms_per_scan"] == 150.0
    assert built["total"]["points_in"] == 12000
    assert built["total"]["bytes"]["total"] == 2 * (3340 + FRAMING)


def test_baselines_stand_under_their_names_and_errors(out: Path) -> None:
    baselines = report.build(out)["baselines"]
    assert baselines["xz"]["0"]["bit_exact_scans"] == 1
    assert baselines["xz"]["0"]["in_order"]
    octree = baselines["octree"]["0.01"]
    assert octree["points_lost"] > 0 and octree["bpp"]["total"] is None
    assert octree["max_axis_error_m"] <= 0.01 + 1e-5
    assert octree["promise_kept"] and baselines["xz"]["0"]["promise_kept"]


def test_a_broken_promise_is_shown(out: Path) -> None:
    rows = recorded(out, "baselines").to_pylist()
    moved = [row | {"max_axis_error_m": 0.011} if row["baseline"] == "octree" else row for row in rows]
    record(out, baselines=pa.Table.from_pylist(moved, schema=BASELINES_SCHEMA))
    assert report.build(out)["baselines"]["octree"]["0.01"]["promise_kept"] is False
    table = pq.read_table(out / "report" / "tables" / "baselines.parquet").to_pylist()
    assert [row["promise"] for row in table if row["codec"] == "octree"] == ["per axis, BROKEN"]


def test_curves_of_each_sequence_and_the_front(out: Path) -> None:
    rows = recorded(out, "baselines").to_pylist()
    rows += [row | {"sequence": "04"} for row in rows]
    record(out, baselines=pa.Table.from_pylist(rows, schema=BASELINES_SCHEMA))
    report.build(out)
    page = (out / "report" / "index.html").read_text()
    assert page.count("<svg") == 7 and "sequence by sequence" in page
    assert _front([(3.0, 5.0), (1.0, 9.0), (2.0, 9.5), (4.0, 4.0)]) == [(1.0, 9.0), (3.0, 5.0), (4.0, 4.0)]


def test_a_codec_that_is_not_here_has_one_row_that_says_so(out: Path) -> None:
    report.build(out)
    rows = pq.read_table(out / "report" / "tables" / "baselines.parquet").to_pylist()
    (absent,) = [row for row in rows if row["codec"] == "tmc13"]
    assert absent["remark"] == "not run: tmc3 not found" and absent["bpp_geometry"] is None
    assert absent["asked"] == "any"


def test_the_page_stands_alone_and_escapes(out: Path) -> None:
    report.build(out)
    page = (out / "report" / "index.html").read_text()
    assert not re.findall(r"(?:src|href)=[\"'](?!data:|#)", page)
    assert not re.findall(r"url\((?!#|data:)", page) and page.count("<script") == 2  # of the scan to turn
    assert "a&lt;b&gt;.bin" in page and "<b>.bin" not in page
    assert page.count("<svg") == 5 and page.count("data:image/png") == 8
    assert "30.00 mm" in page and "2026-11-22 01:30 UTC" in page


def test_what_the_paper_publishes_is_shown_when_it_is_asked_for(out: Path) -> None:
    for paper in (False, True):
        report.build(out, paper=paper)
        page = (out / "report" / "index.html").read_text()
        assert ("As the paper publishes" in page) == ("Not in this report" in page) == paper


def test_tables_are_written_as_markdown_and_parquet(out: Path) -> None:
    report.build(out)
    text = (out / "report" / "tables.md").read_text()
    assert "| 00 | 2 | 6,000 |" in text
    assert "cut \\| off" in text
    rows = pq.read_table(out / "report" / "tables" / "sequences.parquet").to_pylist()
    assert [row["sequence"] for row in rows] == ["00", "04", "all"]
    assert rows[1]["max_error_mm"] == pytest.approx(30, abs=0.01)


def test_a_run_in_which_everything_failed_still_reports(tmp_path: Path) -> None:
    failure = {"sequence": "00", "name": "000000", "stage": "ingest", "file": "x.bin", "message": "truncated"}
    record(tmp_path, {}, failures=pa.Table.from_pylist([failure], schema=FAILURES))
    built = report.build(tmp_path)
    assert built["sequences"] == {} and built["total"]["frames"] == 0
    assert built["failures"] == [failure]
    assert "No scan was measured" in (tmp_path / "report" / "index.html").read_text()


def test_report_json_is_strict_json_when_nothing_matches(out: Path) -> None:
    metrics = recorded(out, "metrics").to_pylist()
    metrics[0] |= {"max_error_m": float("inf"), "bit_exact": False}
    record(out, metrics=pa.Table.from_pylist(metrics, schema=recorded(out, "metrics").schema))
    built = report.build(out)
    assert built["sequences"]["00"]["max_error_m"] is None
    assert built["sequences"]["00"]["scans_without_correspondence"] == 1
    assert "Infinity" not in (out / "report" / "report.json").read_text()


def test_measurements_of_a_newer_version_are_refused(out: Path) -> None:
    path = out / "report" / "metrics.parquet"
    table = pq.read_table(path)
    pq.write_table(table.replace_schema_metadata({b"salpcc.evaluate.version": b"999"}), path)
    with pytest.raises(ShardError, match="version 999"):
        report.build(out)


def test_measurements_of_an_older_version_are_read(out: Path) -> None:
    path = out / "report" / "baselines.parquet"
    old = pq.read_table(path).drop_columns(["memory_mb"])
    pq.write_table(old.replace_schema_metadata({b"salpcc.evaluate.version": b"1"}), path)
    assert report.build(out)["baselines"]["xz"]["0"]["memory_mb"] is None


def test_damaged_measurements_are_one_clear_error(out: Path) -> None:
    (out / "report" / "times.parquet").write_bytes(b"not parquet")
    with pytest.raises(ShardError, match=r"times\.parquet: not readable"):
        report.build(out)


def test_report_is_the_same_when_rebuilt(out: Path) -> None:
    def strip(built: dict[str, Any]) -> str:
        return json.dumps(built, sort_keys=True)

    first, page = strip(report.build(out)), (out / "report" / "index.html").read_bytes()
    assert strip(report.build(out)) == first
    assert (out / "report" / "index.html").read_bytes() == page


def test_a_browser_shows_the_page(out: Path, browser: Any) -> None:
    """The scan is drawn, class by class in its colour, and turns; on a phone nothing but tables and plots is wider than it."""
    report.build(out)
    browser.goto((out / "report" / "index.html").as_uri())
    canvas = browser.locator("#scene[data-state=drawn] canvas")
    legend = browser.locator("#scene .legend")
    canvas.wait_for()
    assert legend.inner_text().split() == ["road", "building"]  # the car was dropped

    def picture() -> Any:
        return imread(BytesIO(canvas.screenshot()))[..., :3]

    before = picture()
    drawn = np.abs(before - before[0, 0]).max(axis=2) > 0.2
    assert 0.002 < drawn.mean() < 0.9
    assert len(np.unique(np.rint(before[drawn] * 8), axis=0)) >= 2
    canvas.drag_to(canvas, source_position={"x": 300, "y": 200}, target_position={"x": 500, "y": 260})
    browser.wait_for_timeout(100)  # it is drawn again with the next frame
    assert np.abs(picture() - before).max() > 0.2
    browser.locator("#scene select").select_option("height")
    assert re.fullmatch(r"-[0-9.]+ m\s*[0-9.]+ m", legend.inner_text().strip())
    assert browser.locator(".claims dt").count() >= 4 and browser.locator("table").count() >= 4
    browser.set_viewport_size({"width": 390, "height": 800})
    assert browser.evaluate("document.scrollingElement.scrollWidth") == 390
    browser.screenshot(path=out / "phone.png", full_page=True)
