"""Runs: bytes that depend on the scans only, resuming, failures, and what is left behind."""

import json
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import NoReturn

import pytest

from salpcc.pipeline import run as module
from salpcc.pipeline.graph import sequence, tasks
from salpcc.pipeline.graph.graph import GraphOptions
from salpcc.pipeline.run import RunRequest, RunResult, run_sequences
from salpcc.pipeline.schedule.lock import locked
from salpcc.pipeline.schedule.progress import Silent
from salpcc.pipeline.verify import verify
from salpcc.schemas.config import RunConfig
from salpcc.schemas.errors import LockedError, SalpccError, UsageError
from salpcc.stages.residual_code.archive.reader import ArchiveReader

Run = Callable[..., RunResult]


def archives(out: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in (out / "archives").iterdir()}


def test_report_has_what_the_contract_names(done: Path) -> None:
    report = json.loads((done / "report" / "report.json").read_text())
    assert set(report["sequences"]) == {"00", "01"}
    figures = report["sequences"]["00"]
    assert figures["frames"] == figures["bit_exact_scans"] == 5
    assert figures["points_in"] == figures["points_kept"] == figures["points_decoded"] > 10000
    assert figures["max_error_m"] == 0 and figures["points_dropped_movable"] == 0
    beside = figures["labels"]["bytes"] + figures["side_files"]["bytes"]
    assert figures["bytes"]["total"] == (done / "archives" / "00.mcap").stat().st_size - beside
    assert set(figures["bytes"]) >= {"geometry", "intensity", "classes", "side", "total"}
    spent = figures["ms_per_scan"]
    stages = {"ingest", "segment", "ground_fit", "predict", "residual_code"}
    assert set(spent) == stages | {"labels"} and spent["labels"] > 0  # which are no part of the codec's time
    assert figures["encode_ms_per_scan"] > 0 and figures["decode_ms_per_scan"] > 0
    assert (done / "report" / "index.html").exists()


def test_configuration_lies_beside_the_results(done: Path) -> None:
    config = json.loads((done / "config.json").read_text())
    assert config["gop"] == 2 and config["keep_movable"] is True and len(config["sensor_digest"]) == 64


def test_intermediate_shards_are_gone(done: Path) -> None:
    assert {path.name for path in (done / "shards" / "00").iterdir()} == {"aside", "evaluate"}


def test_worker_processes_give_the_same_bytes(done: Path, toy_root: Path, tmp_path: Path, run: Run) -> None:
    for workers in (1, 2):
        assert not run(toy_root, tmp_path / str(workers), "00", "01", workers=workers).failed
        assert archives(tmp_path / str(workers)) == archives(done)


def test_second_run_does_nothing_again(
    done: Path, toy_root: Path, tmp_path: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"
    shutil.copytree(done, out)
    before = {path: path.stat().st_mtime_ns for path in out.rglob("*.mcap")}
    monkeypatch.setattr(
        tasks, "STAGES", {n: replace(s, run=None) for n, s in tasks.STAGES.items()}
    )  # any stage that ran would break
    monkeypatch.setattr(sequence.evaluate, "run", None)
    result = run(toy_root, out, "00", "01")
    assert not result.failed and result.report is not None
    assert result.report["sequences"]["00"]["bit_exact_scans"] == 5
    assert {path: path.stat().st_mtime_ns for path in out.rglob("*.mcap")} == before


def test_changed_scan_or_configuration_is_done_again(
    done: Path, toy_root: Path, tmp_path: Path, run: Run
) -> None:
    out, root = tmp_path / "out", tmp_path / "root"
    shutil.copytree(done, out)
    shutil.copytree(toy_root, root)
    scan = root / "sequences" / "00" / "velodyne" / "000002.bin"
    scan.write_bytes(scan.read_bytes()[:-16])
    overwrite = GraphOptions(overwrite=True)
    assert not run(root, out, "00", "01", graph=overwrite).failed
    assert archives(out)["00.mcap"] != archives(done)["00.mcap"]
    assert archives(out)["01.mcap"] == archives(done)["01.mcap"]
    assert verify(out / "archives" / "00.mcap", root).bit_exact_scans == 5
    run(toy_root, out, "00", max_error=0.01, graph=overwrite)
    assert verify(out / "archives" / "00.mcap", toy_root).max_error_m <= 0.01  # type: ignore[operator]


def test_damaged_archive_is_made_again(done: Path, toy_root: Path, tmp_path: Path, run: Run) -> None:
    out = tmp_path / "out"
    shutil.copytree(done, out)
    whole = (out / "archives" / "00.mcap").read_bytes()
    (out / "archives" / "00.mcap").write_bytes(whole[:-100])
    assert not run(toy_root, out, "00").failed
    assert (out / "archives" / "00.mcap").read_bytes() == whole


def test_stages_can_be_run_one_by_one(done: Path, toy_root: Path, tmp_path: Path, run: Run) -> None:
    result = run(toy_root, tmp_path, "00", graph=GraphOptions(last="segment"))
    assert result.report is None and not (tmp_path / "archives").exists()
    made = {path: path.stat().st_mtime_ns for path in (tmp_path / "shards").rglob("*.arrow")}
    assert len(made) == 6  # three GOPs, two stages
    run(
        toy_root,
        tmp_path,
        "00",
        graph=GraphOptions(first="ground_fit", last="residual_code", forced=True, keep_shards=True),
    )
    assert {path: path.stat().st_mtime_ns for path in made} == made  # reused, not made again
    assert archives(tmp_path)["00.mcap"] == archives(done)["00.mcap"]
    run(toy_root, tmp_path, "00", graph=GraphOptions(first="segment", forced=True, keep_shards=True))
    again = {path for path in made if path.stat().st_mtime_ns != made[path]}
    assert {path.parent.name for path in again} == {"segment"} and len(again) == 3


@pytest.fixture
def damaged_root(toy_root: Path, tmp_path: Path) -> Path:
    root = tmp_path / "root"
    shutil.copytree(toy_root, root)
    (root / "sequences/00/velodyne/000001.bin").write_bytes(bytes(1001))
    (root / "sequences/00/velodyne/000004.bin").write_bytes(bytes(17))  # alone in its GOP
    return root


def test_failed_scans_cost_themselves_only(
    damaged_root: Path, toy_root: Path, tmp_path: Path, run: Run
) -> None:
    for _ in range(2):  # the second time from the record of the first
        result = run(damaged_root, tmp_path / "out", "00", "01", "33")
        assert [(e.sequence, e.scan) for e in result.errors] == [
            ("33", ""),
            ("00", "000001"),
            ("00", "000004"),
        ]
        assert result.report is not None and result.report["sequences"]["00"]["frames"] == 3
    listed = json.loads((tmp_path / "out/report/report.json").read_text())["errors"]
    assert "000001.bin: truncated" in json.dumps(listed)
    verdict = verify(tmp_path / "out" / "archives" / "00.mcap", toy_root)
    assert verdict.problems == [f"scan 000001: not in the archive, but in {toy_root}"]
    assert verdict.bit_exact_scans == 3 and verdict.scans_elsewhere == ["000001", "000004"]


def test_mended_scans_are_done_when_they_are_there(
    damaged_root: Path, toy_root: Path, done: Path, tmp_path: Path, run: Run
) -> None:
    run(damaged_root, tmp_path / "out", "00")
    assert not run(toy_root, tmp_path / "out", "00").failed
    assert archives(tmp_path / "out")["00.mcap"] == archives(done)["00.mcap"]


def broken(stage: str, scans: set[str]) -> Callable[..., object]:
    """A stage that breaks whenever one of ``scans`` is among its rows."""
    real = tasks.STAGES[stage].run

    def breaks(task, *others):  # type: ignore[no-untyped-def]
        if scans & set(task.column("name").to_pylist()):
            raise ZeroDivisionError("odd plane")
        return real(task, *others)

    return breaks


@pytest.mark.parametrize("stage", ["segment", "ground_fit", "predict", "residual_code"])
def test_a_scan_that_breaks_a_stage_costs_itself_and_is_tried_again(
    stage: str, done: Path, toy_root: Path, tmp_path: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    graph = GraphOptions(keep_shards=True)
    with monkeypatch.context() as patch:
        patch.setitem(tasks.STAGES, stage, replace(tasks.STAGES[stage], run=broken(stage, {"000002"})))
        result = run(toy_root, tmp_path, "00", graph=graph)
    assert [(e.scan, e.stage) for e in result.errors] == [("000002", stage)]
    assert "odd plane" in result.errors[0].reason
    verdict = verify(tmp_path / "archives" / "00.mcap", toy_root)
    assert verdict.scans_elsewhere == ["000002"] and verdict.bit_exact_scans == 4
    assert not run(toy_root, tmp_path, "00", graph=graph).failed
    assert archives(tmp_path)["00.mcap"] == archives(done)["00.mcap"]


def test_a_gop_that_breaks_a_stage_leaves_the_other_gops(
    done: Path, toy_root: Path, tmp_path: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patch:
        patch.setitem(
            tasks.STAGES,
            "predict",
            replace(tasks.STAGES["predict"], run=broken("predict", {"000002", "000003"})),
        )
        result = run(toy_root, tmp_path, "00")
    assert [(e.scan, e.stage) for e in result.errors] == [("000002", "predict"), ("000003", "predict")]
    names = [[e.name for e in gop] for gop in ArchiveReader(tmp_path / "archives" / "00.mcap").gops]
    assert names == [["000000", "000001"], [], ["000004"]]
    assert not run(toy_root, tmp_path, "00").failed
    assert archives(tmp_path)["00.mcap"] == archives(done)["00.mcap"]


def test_an_archive_written_anew_is_measured_anew(
    done: Path, toy_root: Path, tmp_path: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patch:
        patch.setitem(
            tasks.STAGES,
            "predict",
            replace(tasks.STAGES["predict"], run=broken("predict", {f"{n:06d}" for n in range(5)})),
        )
        result = run(toy_root, tmp_path, "00")
    assert result.report is not None and not result.report["sequences"]
    result = run(toy_root, tmp_path, "00")
    assert result.report is not None and result.report["sequences"]["00"]["bit_exact_scans"] == 5
    assert archives(tmp_path)["00.mcap"] == archives(done)["00.mcap"]


@pytest.mark.parametrize("mine", [b'{"mine": 1}', b"[]", b"mine"])
def test_a_config_of_something_else_is_not_replaced(
    toy_root: Path, tmp_path: Path, run: Run, mine: bytes
) -> None:
    (tmp_path / "config.json").write_bytes(mine)
    with pytest.raises(UsageError, match=r"config\.json: of no run"):
        run(toy_root, tmp_path, "00")
    assert [path.read_bytes() for path in tmp_path.iterdir()] == [mine]


def test_a_full_disk_ends_the_run_and_the_next_one_goes_on(
    done: Path, toy_root: Path, tmp_path: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = sequence.write_archive

    def full(*arguments: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(sequence, "write_archive", full)
    with pytest.raises(SalpccError, match="No space left"):
        run(toy_root, tmp_path, "00")
    monkeypatch.setattr(sequence, "write_archive", real)
    monkeypatch.setattr(
        tasks, "STAGES", {n: replace(s, run=None) for n, s in tasks.STAGES.items()}
    )  # the shards are there
    assert not run(toy_root, tmp_path, "00").failed
    assert archives(tmp_path)["00.mcap"] == archives(done)["00.mcap"]


def test_two_runs_on_one_output_are_refused(toy_root: Path, tmp_path: Path, run: Run) -> None:
    with locked(tmp_path), pytest.raises(LockedError, match="another run"):
        run(toy_root, tmp_path, "00")


def test_given_labels_drop_movables_and_count_them(toy_root: Path, tmp_path: Path, run: Run) -> None:
    result = run(toy_root, tmp_path, "01", keep_movable=False, drop_movable=True, labels="given")
    assert result.report is not None
    figures = result.report["sequences"]["01"]
    share = figures["points_dropped_movable"] / figures["points_in"]
    assert 0.35 < share < 0.45  # cars and moving cars are 2 of 5 labels
    assert (
        figures["points_decoded"]
        == figures["points_kept"]
        == figures["points_in"] - figures["points_dropped_movable"]
    )
    assert figures["iou"]["miou"] == 1.0  # dropped points have their classes, too
    assert {"car", "road"} <= set(figures["iou"]["classes"])
    verdict = verify(tmp_path / "archives" / "01.mcap", toy_root)
    assert verdict.good and verdict.bit_exact_scans == 3
    assert verdict.points_dropped == figures["points_dropped_movable"]


@pytest.mark.parametrize("bound", [0.005, 0.02])
def test_no_point_is_farther_than_asked(toy_root: Path, tmp_path: Path, run: Run, bound: float) -> None:
    result = run(toy_root, tmp_path, "01", max_error=bound)
    assert result.report is not None
    assert 0 < result.report["sequences"]["01"]["max_error_m"] <= bound
    assert verify(tmp_path / "archives" / "01.mcap", toy_root).good


def test_a_baseline_is_measured_beside(toy_root: Path, tmp_path: Path, run: Run) -> None:
    result = run(toy_root, tmp_path, "01", baselines=("xz",))
    assert result.report is not None and "xz" in result.report["baselines"]


def test_something_moves_before_the_workers_are_there(
    toy_root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They take seconds to start, and the first group is compiled for."""
    seen: list[str] = []

    @contextmanager
    def bar(total: int, unit: str, quiet: bool) -> Iterator[Silent]:
        seen.append(f"{total} {unit}")
        yield Silent()

    def connect(*_: object) -> NoReturn:
        seen.append("connect")
        raise UsageError("no workers today")

    monkeypatch.setattr(module, "bar", bar)
    monkeypatch.setattr(module, "connect", connect)
    request = RunRequest(RunConfig(keep_movable=True), ["00"], tmp_path / "out", toy_root)
    with pytest.raises(UsageError, match="no workers"):
        run_sequences(request)
    with pytest.raises(UsageError, match="no workers"):
        run_sequences(replace(request, graph=GraphOptions(last="residual_code")))
    assert seen == ["10 scans coded or measured", "connect", "5 scans", "connect"]
