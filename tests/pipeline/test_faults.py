"""What a run lives through: afterwards the same command ends with the bytes of an undisturbed run.

``SALPCC_KILLS=100`` kills that many workers (``make soak``).
"""

import os
import random
import resource
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import dask
import psutil
import pytest

from salpcc.pipeline.graph.graph import GraphOptions
from salpcc.pipeline.run import RunResult
from salpcc.pipeline.schedule.cluster import connect
from salpcc.pipeline.schedule.lock import locked

Run = Callable[..., RunResult]
KILLS = int(os.environ.get("SALPCC_KILLS", "3"))
COMMAND = [sys.executable, "-m", "salpcc.pipeline.cli", "run", "sequences", "00,01", "--workers", "2"]
COMMAND += ["--labels", "given", "--effort", "fast", "--gop", "1"]  # two layers, labels, side files
OPTIONS: dict[str, Any] = {"labels": "given", "keep_movable": False, "effort": "fast", "gop": 1}


@pytest.fixture(scope="module")
def whole(toy_root: Path, tmp_path_factory: pytest.TempPathFactory, run: Run) -> dict[str, bytes]:
    """The archives of an undisturbed run."""
    out = tmp_path_factory.mktemp("whole")
    assert not run(toy_root, out, "00", "01", **OPTIONS).failed
    return archives(out)


@pytest.fixture
def again(toy_root: Path, run: Run) -> Callable[[Path], dict[str, bytes]]:
    """The same run once more, undisturbed, in this process: its archives."""

    def go(out: Path) -> dict[str, bytes]:
        assert not run(toy_root, out, "00", "01", **OPTIONS).failed
        assert not list(out.rglob("*.part"))
        return archives(out)

    return go


def archives(out: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in (out / "archives").glob("*.mcap")}


def shards(out: Path) -> int:
    return len(list((out / "shards").rglob("*.arrow")))


def start(root: Path, out: Path, **options: object) -> "subprocess.Popen[str]":
    command = [*COMMAND, "--root", str(root), "--out", str(out)]
    return subprocess.Popen(
        command,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        **options,
    )  # type: ignore[call-overload, no-any-return]


def wait_for_shards(out: Path, count: int, run: "subprocess.Popen[str]") -> None:
    deadline = time.monotonic() + 300
    while shards(out) < count:
        assert run.poll() is None, "it was faster than the test"
        assert time.monotonic() < deadline
        time.sleep(0.005)


def workers() -> list[psutil.Process]:
    """Dask's worker processes below this one."""
    found = []
    for process in psutil.Process().children(recursive=True):
        try:
            parent = process.parent()
            if parent is not None and any("multiprocessing.forkserver" in part for part in parent.cmdline()):
                found.append(process)
        except psutil.Error:
            continue
    return found


@pytest.mark.parametrize("count", [1, 12])
def test_killed_run_goes_on_to_the_same_bytes(
    count: int,
    whole: dict[str, bytes],
    toy_root: Path,
    tmp_path: Path,
    again: Callable[[Path], dict[str, bytes]],
) -> None:
    first = start(toy_root, tmp_path)
    wait_for_shards(tmp_path, count, first)
    below = psutil.Process(first.pid).children(recursive=True)
    first.kill()
    assert first.wait() == -signal.SIGKILL
    _, alive = psutil.wait_procs(below, timeout=120)  # they end when their parent does
    assert not alive and archives(tmp_path) != whole
    assert again(tmp_path) == whole


def test_interrupted_run_says_so_and_goes_on(
    whole: dict[str, bytes], toy_root: Path, tmp_path: Path, again: Callable[[Path], dict[str, bytes]]
) -> None:
    def listen() -> None:  # a shell that runs the tests in its background has told them to ignore Ctrl-C
        signal.signal(signal.SIGINT, signal.SIG_DFL)

    first = start(toy_root, tmp_path, preexec_fn=listen)
    wait_for_shards(tmp_path, 5, first)
    os.killpg(first.pid, signal.SIGINT)  # as the terminal does: to all of the group
    _, said = first.communicate(timeout=120)
    assert first.returncode == 130
    assert said.strip().splitlines()[-1] == "error: interrupted; the same command goes on where it stopped"
    assert "Traceback" not in said
    assert again(tmp_path) == whole


def test_full_disk_is_one_clear_line_and_the_run_goes_on(
    whole: dict[str, bytes], toy_root: Path, tmp_path: Path, again: Callable[[Path], dict[str, bytes]]
) -> None:
    """No file may grow beyond 40 kB: shards fit, larger ones and archives do not."""

    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (40_000, 40_000))

    first = start(toy_root, tmp_path, preexec_fn=limit)
    _, said = first.communicate(timeout=120)
    assert first.returncode == 1
    last = said.strip().splitlines()[-1]
    assert "File too large" in last and "run the same command again" in last, said
    assert "Traceback" not in said
    assert not archives(tmp_path) and not list(tmp_path.rglob("*.part"))
    assert again(tmp_path) == whole


@pytest.fixture
def killer() -> Iterator[Callable[[Path, int, int], threading.Thread]]:
    """Kill a worker whenever so many shards have been written; ends with the test."""
    stop = threading.Event()
    threads = []

    def begin(out: Path, kills: int, total: int) -> threading.Thread:
        rng = random.Random(kills)
        moments = sorted(rng.sample(range(1, total), kills))

        def kill() -> None:
            for moment in moments:
                while not stop.wait(0.005) and (shards(out) < moment or not workers()):
                    pass
                if not stop.is_set():
                    rng.choice(workers()).send_signal(signal.SIGKILL)
                    done.append(moment)

        done: list[int] = []
        thread = threading.Thread(target=kill)
        thread.done = done  # type: ignore[attr-defined]
        threads.append(thread)
        thread.start()
        return thread

    yield begin
    stop.set()
    for thread in threads:
        thread.join()


def test_killed_workers_are_replaced(
    toy: Callable[..., Path], tmp_path: Path, run: Run, killer: Callable[..., threading.Thread]
) -> None:
    """Workers killed at random moments of a run cost time only."""
    scans = max(8, KILLS // 2)
    root = toy(tmp_path / "root", "00", list(range(scans)))
    assert not run(root, tmp_path / "whole", "00", effort="fast", gop=1).failed
    out = tmp_path / "out"
    thread = killer(out, KILLS, 5 * scans - 4)
    result = run(root, out, "00", effort="fast", gop=1, workers=2, graph=GraphOptions(keep_shards=True))
    thread.join()
    assert len(thread.done) == KILLS  # type: ignore[attr-defined]
    assert not result.failed
    assert archives(out) == archives(tmp_path / "whole")


def test_a_worker_that_is_slow_to_come_back_is_replaced() -> None:
    """Dask gives up a worker that is not back in time; with none left, a run would wait for ever."""
    with dask.config.set({"distributed.deploy.lost-worker-timeout": "10ms"}), connect(1, None) as client:
        (first,) = workers()
        first.kill()
        assert client.submit(sum, [1, 2]).result(timeout=300) == 3


def test_a_scan_that_cannot_be_read_costs_itself(
    whole: dict[str, bytes],
    toy: Callable[..., Path],
    tmp_path: Path,
    run: Run,
    again: Callable[[Path], dict[str, bytes]],
) -> None:
    root = toy(tmp_path / "root", "00", [0, 1, 2, 3, 4])
    scan = root / "sequences/00/velodyne/000001.bin"
    content = scan.read_bytes()
    scan.unlink()
    scan.mkdir()  # opens, but reading it is an error
    result = run(root, tmp_path / "out", "00", **OPTIONS)
    assert [(e.scan, e.stage) for e in result.errors] == [("000001", "ingest")]
    assert result.report is not None and result.report["sequences"]["00"]["bit_exact_scans"] == 4
    scan.rmdir()
    scan.write_bytes(content)
    assert not run(root, tmp_path / "out", "00", **OPTIONS).failed
    assert archives(tmp_path / "out")["00.mcap"] == whole["00.mcap"]


def test_second_run_on_an_output_is_one_clear_error(toy_root: Path, tmp_path: Path) -> None:
    with locked(tmp_path):
        second = start(toy_root, tmp_path)
        _, said = second.communicate(timeout=120)
    assert second.returncode == 1
    assert said.count("\n") == 1 and f"another run (process {os.getpid()})" in said
