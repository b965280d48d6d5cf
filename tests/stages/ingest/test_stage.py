"""The ingest stage: a scan that fails is told of, the others go on."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from salpcc.schemas.cloud import Cloud
from salpcc.schemas.config import RunConfig
from salpcc.schemas.scan import Scan
from salpcc.schemas.shards import facts_of, table_to_sweeps
from salpcc.schemas.work import GopSource
from salpcc.stages.ingest import stage
from salpcc.stages.ingest.sources import SOURCES
from salpcc.stages.lattice import sweep as sweep_module
from salpcc.stages.lattice.sensor_model import SensorModel, load_sensor
from salpcc.stages.lattice.sweep import sweep_to_scan

CLOUD = Cloud("/points", "cdr", b"", b"", b"", np.empty((0, 0), np.uint8))


def gop_of(root: Path, sequence: str) -> GopSource:
    return GopSource("semantickitti", sequence, 0, tuple(SOURCES["semantickitti"].scans(root, sequence)))


def test_sweeps_give_the_scans_back(toy_root: Path) -> None:
    gop = gop_of(toy_root, "01")
    table = stage.run(gop, RunConfig())
    assert facts_of(table.schema)["errors"] == []
    for ref, sweep in zip(gop.scans, table_to_sweeps(table), strict=True):
        source = SOURCES["semantickitti"].read(ref, with_labels=False)
        back = sweep_to_scan(sweep, load_sensor("hdl64e"))
        assert back.points.tobytes() == source.points.tobytes()
        assert (sweep.name, sweep.time, sweep.classes) == (ref.name, ref.time, None)


def test_given_labels_travel_with_the_sweep(toy_root: Path) -> None:
    sweeps = table_to_sweeps(stage.run(gop_of(toy_root, "01"), RunConfig(labels="given")))
    assert all(s.classes is not None and len(np.unique(s.classes)) == 4 for s in sweeps)


def test_failed_scans_are_listed_and_the_others_done(toy_root: Path, tmp_path: Path) -> None:
    shutil.copytree(toy_root / "sequences" / "00", tmp_path / "sequences" / "00")
    (tmp_path / "sequences/00/velodyne/000001.bin").write_bytes(bytes(17))
    (tmp_path / "sequences/00/velodyne/000003.bin").unlink()
    gop = gop_of(toy_root, "00")
    moved = tuple(
        type(r)(**{**vars(r), "path": r.path.replace(str(toy_root), str(tmp_path))}) for r in gop.scans
    )
    table = stage.run(GopSource("semantickitti", "00", 0, moved), RunConfig())
    assert table.column("name").to_pylist() == ["000000", "000002", "000004"]
    errors = facts_of(table.schema)["errors"]
    assert [(e["scan"], e["stage"]) for e in errors] == [("000001", "ingest"), ("000003", "ingest")]


def test_a_kernel_that_breaks_on_one_scan_costs_that_scan(
    toy_root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = stage.scan_to_sweep

    def breaks(scan, sensor, start, seek):  # type: ignore[no-untyped-def]
        if scan.name == "000001":
            raise ZeroDivisionError("odd scan")
        return real(scan, sensor, start, seek)

    monkeypatch.setattr(stage, "scan_to_sweep", breaks)
    table = stage.run(gop_of(toy_root, "01"), RunConfig())
    assert table.num_rows == 2
    assert "odd scan" in facts_of(table.schema)["errors"][0]["reason"]


def test_motion_starts_from_the_scan_before_only_where_frames_are_consecutive(
    toy_root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    starts = []
    real = stage.scan_to_sweep

    def spy(scan, sensor, start, seek):  # type: ignore[no-untyped-def]
        starts.append(start is not None)
        sweep = real(scan, sensor, start)
        return type(sweep)(**{**vars(sweep), "motion": np.zeros(6)})

    monkeypatch.setattr(stage, "scan_to_sweep", spy)
    stage.run(gop_of(toy_root, "01"), RunConfig())  # frames 0, 1, 7
    assert starts == [False, True, False]


@pytest.mark.parametrize("logged", [False, True])
def test_what_was_sought_in_vain_twice_is_sought_no_more(
    monkeypatch: pytest.MonkeyPatch, sensor: SensorModel, logged: bool
) -> None:
    rng = np.random.default_rng(0)
    sought: list[int] = []
    turns: list[int] = []  # a folder's scans are of the sensor that was named, most likely
    monkeypatch.setattr(sweep_module, "solve_motion", lambda points, _: turns.append(len(points)))
    monkeypatch.setattr(sweep_module, "find_motion", lambda points, _: sought.append(len(points)))
    project = stage.Projector(sensor)
    for number in range(5):
        points = rng.normal(0, 9, (300 + number, 3)).astype(np.float32)
        scan = Scan(f"{number:06d}", points, np.zeros(len(points), np.float32))
        project(number, replace(scan, cloud=CLOUD) if logged else scan)
    assert sought == [300, 301]
    assert turns == (sought if logged else [300, 301, 302, 303, 304])


def test_no_motion_is_sought_by_what_is_no_return(
    monkeypatch: pytest.MonkeyPatch, sensor: SensorModel
) -> None:
    points = np.random.default_rng(0).normal(0, 9, (900, 3)).astype(np.float32)
    points[::3], points[1::90] = 0.0, np.nan
    seen: list[np.ndarray] = []
    monkeypatch.setattr(sweep_module, "solve_motion", lambda points, _: seen.append(points))
    stage.Projector(sensor)(0, Scan("000000", points, np.zeros(len(points), np.float32)))
    (given,) = seen
    assert len(given) == 590
    assert given.any(axis=1).all()
