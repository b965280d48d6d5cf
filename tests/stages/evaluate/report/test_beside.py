"""A report over several runs, and what other commands recorded: the paper's tables beside what it publishes."""

from __future__ import annotations

import io
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from matplotlib.image import imsave

from salpcc.schemas.scan import Scan
from salpcc.schemas.shards import KEPT
from salpcc.stages.evaluate import stage
from salpcc.stages.evaluate.report import write as report
from salpcc.stages.evaluate.report.record import SCHEMAS, record
from salpcc.stages.evaluate.report.schema import TIMES
from salpcc.stages.ingest.paper_grid import grid_to_scan, row_elevations, scan_to_grid

Street = Callable[..., Scan]
CAR, VEGETATION = 1, 15


def rows(name: str, *found: dict[str, Any]) -> pa.Table:
    return pa.Table.from_pylist(list(found), schema=SCHEMAS[name])


@pytest.fixture
def runs(
    tmp_path: Path,
    street: Street,
    without_movable: Callable[[Scan], Scan],
    payload_rows: Callable[..., pa.Table],
) -> tuple[Path, Path]:
    """A run of the network that misses ten points, and one of the paper's profile that loses what shares a cell."""
    scan = street("000000")
    assert scan.classes is not None
    said = scan.classes.copy()
    said[np.flatnonzero(said == CAR)[:10]] = VEGETATION
    kept = without_movable(replace(scan, classes=said))
    dropped = {scan.name: np.where(said == CAR, said, np.uint8(KEPT))}
    grid = grid_to_scan(scan_to_grid(kept, 0.005, row_elevations([kept.points])))
    times = {"sequence": "04", "gop": 0, "stage": "segment", "scans": 1, "cpu_ms": 250.0, "wall_ms": 300.0}
    for folder, back, config in (
        ("network", kept, {"labels": "network"}),
        ("paper", grid, {"profile": "paper", "max_error": 0.005, "coder": "context", "labels": "given"}),
    ):
        payloads = payload_rows([scan], [kept])
        metrics = stage.run(
            [back],
            [scan],
            payloads,
            sequence="04",
            gop=0,
            dropped=dropped,
            max_error=0.005 if folder == "paper" else 0.0,
            in_order=folder == "network",
            sample=True,
        )
        record(
            tmp_path / folder,
            {"config": config},
            metrics=metrics,
            times=pa.Table.from_pylist([times], schema=TIMES),
        )
    return tmp_path / "network", tmp_path / "paper"


def table(out: Path, name: str) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = pq.read_table(out / "report" / "tables" / f"{name}.parquet").to_pylist()
    return found


def test_dropped_points_count_in_every_measure_of_the_segmentation(
    runs: tuple[Path, Path], street: Street
) -> None:
    out, _ = runs
    classes = street("000000").classes
    assert classes is not None
    cars = int((classes == CAR).sum())
    iou = report.build(out)["total"]["iou"]
    assert (
        iou["groups"]["movable"]
        == iou["classes"]["car"]
        == iou["movable_recall"]
        == pytest.approx(1 - 10 / cars)
    )
    assert iou["movable_precision"] == 1.0
    assert sum(map(sum, iou["confusion"])) == len(classes)
    *published, measured = table(out, "table1")
    assert published[-1]["method"] == "SA-LPCC (published)" and published[-1]["miou"] == 55.24
    assert measured["fps"] == 4.0 and measured["car"] == pytest.approx(100 * (1 - 10 / cars))
    page = (out / "report" / "index.html").read_text()
    assert "Segmentation (Fig. 7)" in page and "Confusion of classes" in page


def test_tables_2_and_4_stand_over_runs_of_both_profiles(runs: tuple[Path, Path]) -> None:
    out, beside = runs
    assert not (out / "report" / "tables").exists()
    built = report.build(out, [beside])
    (rate, total, lost, worst, _) = table(out, "table2")
    assert rate["sequence"] == "04" and total["sequence"] == "all"
    assert rate["run0"] == built["beside"][0]["total"]["geometry_rate_percent"]  # the paper's first
    assert 0 < lost["run0"] < 100 and lost["run1"] == 0
    assert worst["run0"] > 5 and worst["run1"] == 0
    assert table(out, "table4")[0]["segmentation"] == 0.25
    markdown = (out / "report" / "tables.md").read_text()
    assert "paper grid, context coder, 5 mm" in markdown and "sensor profile, bit-exact" in markdown
    assert [row["sequence"] for row in table(out, "published2")][-1] == "average"


def test_records_of_other_commands_are_summed_up_and_shown(runs: tuple[Path, Path]) -> None:
    out, beside = runs
    pair = {
        "sequence": "04",
        "method": "point to plane",
        "cloud": "sensor",
        "max_error": 0.0,
        "movable": False,
    }
    picture = io.BytesIO()
    imsave(picture, np.zeros((4, 8, 3), np.uint8), format="png")
    record(
        beside,
        registration=rows(
            "registration",
            *(
                {**pair, "source": s, "rotation_deg": r, "translation_m": r / 10}
                for s, r in (("0", 0.1), ("1", 0.3))
            ),
        ),
        map_quality=rows(
            "map_quality", {"sequence": "04", "cleaner": "ours", "truth": "movable", "sa": 0.99}
        ),
        coders=rows(
            "coders",
            *(
                {"coder": c, "input": i, "points": 1000, "bytes_out": b, "encode_ms": 2.0, "status": "ok"}
                for c, i, b in (("PPMd", "residual", 800), ("LZ4", "residual", 1600), ("LZ4", "raw", 8000))
            ),
            {"coder": "LZ5", "input": "raw", "status": "not run: lz5 not found"},
        ),
        ablations=rows(
            "ablations",
            *(
                {"study": "Prediction", "sequence": "04", "variant": v, "measure": "bpp", "value": b}
                for v, b in (("none", 9.0), ("planes", 7.5))
            ),
        ),
        pictures=rows(
            "pictures", {"figure": "fig10", "group": "04", "title": "a", "png": picture.getvalue()}
        ),
    )
    built = report.build(out, [beside], paper=True)
    (errors,) = table(out, "table5")
    assert errors["pairs"] == 2 and errors["rotation_deg_mean"] == pytest.approx(0.2)
    assert errors["rotation_deg_std"] == pytest.approx(0.1) and errors["asked"] == "bit-exact"
    assert [row["coder"] for row in table(out, "fig8")] == ["PPMd", "LZ4", "LZ4", "LZ5"]
    assert built["coders"][0]["rate_percent"] == 5.0 and built["coders"][0]["encode_ms"] == 2000.0
    assert [row["bpp"] for row in table(out, "ablation1")] == [9.0, 7.5]
    assert table(out, "map")[0]["sa"] == 0.99
    page = (out / "report" / "index.html").read_text()
    assert "Maps, before and after (Fig. 10)" in page and "Lossless coders (Fig. 8)" in page
    assert "--profile paper" not in page and "--baselines all" in page  # what is missing, and how to make it


def test_what_dropping_saves_is_measured_where_a_run_kept_everything(
    runs: tuple[Path, Path], street: Street, payload_rows: Callable[..., pa.Table], tmp_path: Path
) -> None:
    out, paper = runs
    estimated = report.build(out, [paper])["sequences"]["04"]
    dropped, points = estimated["points_dropped_movable"], estimated["points_in"]
    assert dropped and estimated["bytes_saved"] == round(1600 * dropped / (points - dropped))
    assert [(row["how"], row["bytes_coded"]) for row in table(out, "savings")] == [("estimated", 1600)] * 2

    scan = street("000000")
    keep = tmp_path / "keep"
    sizes = payload_rows([scan], [scan])
    sizes = sizes.set_column(sizes.column_names.index("geometry"), "geometry", pa.array([1250]))
    metrics = stage.run([scan], [scan], sizes, sequence="04", gop=0)
    record(keep, {"config": {"keep_movable": True}}, metrics=metrics)
    built = report.build(out, [paper, keep])
    assert built["total"]["bytes_saved"] == 250 and built["total"]["savings_measured"]
    assert built["total"]["bytes_saved_file"] == 250
    assert table(out, "savings")[0]["share_saved"] == pytest.approx(100 * 250 / 1850)
    assert "saved by leaving out" in (out / "report" / "index.html").read_text()
    # Another error, or other scans, are no measure of this run.
    record(keep, {"config": {"keep_movable": True, "max_error": 0.01}})
    assert not report.build(out, [keep])["total"]["savings_measured"]
    assert "bytes_saved" not in report.build(keep)["total"]
