"""Good archives stay: a run that differs, or fails, replaces none unless it is told to."""

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from salpcc.pipeline.graph import sequence, tasks
from salpcc.pipeline.graph.graph import GraphOptions
from salpcc.pipeline.run import RunResult
from salpcc.pipeline.verify import verify
from salpcc.schemas.errors import UsageError

Run = Callable[..., RunResult]
OVERWRITE = GraphOptions(overwrite=True)


@pytest.fixture
def out(done: Path, tmp_path: Path) -> Path:
    """A folder of outputs with archives of both toy sequences."""
    return Path(shutil.copytree(done, tmp_path / "out"))


def archives(out: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in (out / "archives").iterdir()}


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"max_error": 0.01}, "made with another --max-error"),
        ({"effort": "fast", "gop": 4}, "made with another --effort, --gop"),
        ({"profile": "paper"}, "--profile"),
        ({"keep_movable": False, "labels": "given"}, "--keep-movable, --labels"),
        ({"frames": (0, 2)}, "of 5 scans, not of these 2"),
        ({"source": "simulated"}, "made from --source semantickitti"),
    ],
)
def test_another_run_is_refused_before_it_begins(
    out: Path,
    toy_root: Path,
    run: Run,
    monkeypatch: pytest.MonkeyPatch,
    options: dict[str, object],
    said: str,
) -> None:
    before = archives(out)
    with monkeypatch.context() as patch, pytest.raises(UsageError, match=rf"00\.mcap is there.*{said}"):
        patch.setattr(
            tasks, "STAGES", {n: replace(s, run=None) for n, s in tasks.STAGES.items()}
        )  # any stage that ran would break
        run(toy_root, out, "00", "01", **options)
    assert archives(out) == before
    assert not run(toy_root, out, "00", graph=OVERWRITE, **options).failed
    assert archives(out)["00.mcap"] != before["00.mcap"] and archives(out)["01.mcap"] == before["01.mcap"]


def test_other_files_of_the_same_names_are_refused(
    out: Path, toy_root: Path, tmp_path: Path, run: Run
) -> None:
    root = Path(shutil.copytree(toy_root, tmp_path / "root"))
    scan = root / "sequences" / "00" / "velodyne" / "000002.bin"
    scan.write_bytes(scan.read_bytes()[:-16])
    before = archives(out)
    with pytest.raises(UsageError, match="files of other content"):
        run(root, out, "00")
    assert archives(out) == before


@pytest.mark.parametrize("lost", [range(5), range(2)])
def test_a_run_that_fails_leaves_the_archive(
    out: Path, toy_root: Path, run: Run, monkeypatch: pytest.MonkeyPatch, lost: range
) -> None:
    """Wholly or in part: what is there holds more."""
    before = archives(out)
    real, names = tasks.STAGES["predict"].run, {f"{n:06d}" for n in lost}

    def breaks(task, *others):  # type: ignore[no-untyped-def]
        if names & set(task.column("name").to_pylist()):
            raise ZeroDivisionError("no such device")
        return real(task, *others)

    with monkeypatch.context() as patch:
        patch.setitem(tasks.STAGES, "predict", replace(tasks.STAGES["predict"], run=breaks))
        for options in ({}, {"effort": "fast"}):
            again = GraphOptions(overwrite=True, forced=True)
            result = run(toy_root, out, "00", graph=again, **options)
            assert result.failed and len(result.errors) == len(lost)
            assert archives(out) == before
            assert result.report is not None and result.report["sequences"]["00"]["frames"] == 5
    assert not run(toy_root, out, "00").failed
    assert archives(out) == before


def test_a_run_in_which_all_fails_writes_no_archive(
    toy_root: Path, tmp_path: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    def breaks(*_):  # type: ignore[no-untyped-def]
        raise ZeroDivisionError("no such device")

    monkeypatch.setitem(tasks.STAGES, "segment", replace(tasks.STAGES["segment"], run=breaks))
    result = run(toy_root, tmp_path, "00", "01")
    assert len(result.errors) == 8 and not (tmp_path / "archives").exists()


def test_a_device_that_is_not_there_is_told_before_work_begins(out: Path, toy_root: Path, run: Run) -> None:
    torch = pytest.importorskip("torch")
    if torch.cuda.is_available():
        pytest.skip("there is a GPU here")
    before, config = archives(out), (out / "config.json").read_bytes()
    with pytest.raises(UsageError, match="--device cuda"):
        run(toy_root, out, "00", device="cuda", keep_movable=False, graph=OVERWRITE)
    assert archives(out) == before and (out / "config.json").read_bytes() == config


def test_an_output_grows(
    done: Path, toy_root: Path, tmp_path: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Sequences and baselines are added run by run; the report shows all that is there."""
    out = tmp_path / "out"
    assert not run(toy_root, out, "01").failed
    assert not run(toy_root, out, "00", baselines=("zstd",)).failed
    result = run(toy_root, out, "01", baselines=("xz",))
    assert archives(out) == archives(done)
    report = json.loads((out / "report" / "report.json").read_text())
    assert result.report == report and set(report["sequences"]) == {"00", "01"}
    assert report["total"]["frames"] == 8
    assert set(report["baselines"]) == {"xz", "zstd"}
    assert set(report["sequences"]["00"]["baselines"]) == {"zstd"}
    with monkeypatch.context() as patch:
        patch.setattr(tasks, "STAGES", {n: replace(s, run=None) for n, s in tasks.STAGES.items()})
        patch.setattr(sequence.evaluate, "run", None)
        assert run(toy_root, out, "00").report["total"]["frames"] == 8  # type: ignore[index]
    (out / "archives" / "00.mcap").unlink()
    assert set(run(toy_root, out, "01").report["sequences"]) == {"01"}  # type: ignore[index]


def test_scans_that_failed_are_done_when_they_can_be(
    toy_root: Path, done: Path, tmp_path: Path, run: Run
) -> None:
    root = Path(shutil.copytree(toy_root, tmp_path / "root"))
    (root / "sequences/00/velodyne/000001.bin").write_bytes(bytes(17))
    assert run(root, tmp_path / "out", "00").failed
    assert verify(tmp_path / "out" / "archives" / "00.mcap").scans == 4
    assert not run(toy_root, tmp_path / "out", "00").failed
    assert archives(tmp_path / "out")["00.mcap"] == archives(done)["00.mcap"]
