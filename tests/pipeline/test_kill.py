"""Killed in the middle (SIGKILL), the same command goes on and ends with the same bytes."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

COMMAND = [
    sys.executable,
    "-m",
    "salpcc.pipeline.cli",
    "run",
    "sequences",
    "00,01",
    "--keep-movable",
    "--gop",
    "2",
]


def start(root: Path, out: Path) -> "subprocess.Popen[bytes]":
    command = [*COMMAND, "--root", str(root), "--out", str(out), "--workers", "2"]
    return subprocess.Popen(
        command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True
    )


def archives(out: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in (out / "archives").glob("*.mcap")}


def children_of(pid: int) -> list[int]:
    """Processes whose parent is ``pid``, and theirs."""
    found = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            parent = int(path.read_text().rsplit(")", 1)[1].split()[1])
        except OSError:
            continue
        if parent == pid:
            child = int(path.parent.name)
            found += [child, *children_of(child)]
    return found


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs /proc to find workers")
@pytest.mark.parametrize("shards", [1, 6, 14])
def test_killed_run_goes_on_to_the_same_bytes(
    done: Path, toy_root: Path, tmp_path: Path, shards: int
) -> None:
    first = start(toy_root, tmp_path)
    deadline = time.monotonic() + 120
    while len(list((tmp_path / "shards").rglob("*.arrow"))) < shards and first.poll() is None:
        assert time.monotonic() < deadline
        time.sleep(0.005)
    assert first.poll() is None, "it was faster than the test"
    workers = children_of(first.pid)
    first.kill()
    assert first.wait() == -signal.SIGKILL
    while any(Path(f"/proc/{pid}/exe").exists() for pid in workers):  # they end when their parent does
        assert time.monotonic() < deadline
        time.sleep(0.02)
    assert archives(tmp_path) != archives(done)
    assert start(toy_root, tmp_path).wait(timeout=120) == 0
    assert archives(tmp_path) == archives(done)
    assert not list(tmp_path.rglob("*.part"))


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs /proc to find workers")
def test_killed_worker_is_replaced(done: Path, toy_root: Path, tmp_path: Path) -> None:
    run = start(toy_root, tmp_path)
    deadline = time.monotonic() + 120
    while not list((tmp_path / "shards").rglob("*.arrow")) and run.poll() is None:
        assert time.monotonic() < deadline
        time.sleep(0.005)
    for pid in children_of(run.pid):
        if b"multiprocessing.spawn" in Path(f"/proc/{pid}/cmdline").read_bytes():
            os.kill(pid, signal.SIGKILL)
            break
    else:
        pytest.fail("no worker found")
    assert run.wait(timeout=120) == 0
    assert archives(tmp_path) == archives(done)
