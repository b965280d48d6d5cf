"""Codecs that hang, crash or eat memory, measured in a process of their own: their rows say it, others go on."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from salpcc.schemas.scan import Scan
from salpcc.stages.evaluate.baselines import apart
from salpcc.stages.evaluate.baselines.apart import measure_scans

FAKES = """
import os, subprocess, time
from dataclasses import replace
from pathlib import Path
from salpcc.stages.evaluate.baselines.baseline import Baseline, Group, Promise
from salpcc.stages.evaluate.baselines.generic import from_file, to_file

GOOD = Baseline("good", (), Promise("exact", True, True, True), to_file, from_file)

def hang(points, error):
    program = subprocess.Popen(["sleep", "100"])
    Path(os.environ["FAKE_PID"]).write_text(str(program.pid))
    time.sleep(100)

def crash(points, error):
    os.abort()

def leave(points, error):
    os._exit(7)

def greedy(points, error):
    return to_file(points, len(bytearray(os.urandom(1)) * 60_000_000) * 0)

def talk(points, error):
    print("x" * 100_000, flush=True)
    return to_file(points, error)

FAKES = {
    "good": GOOD,
    "hang": replace(GOOD, encode=hang),
    "crash": replace(GOOD, encode=crash),
    "leave": replace(GOOD, encode=leave),
    "greedy": replace(GOOD, encode=greedy),
    "talk": replace(GOOD, encode=talk),
}
"""


@pytest.fixture
def fakes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """A registry of fake codecs that the other process can import; that process ends with the test."""
    name = f"fake_codecs_{os.getpid()}_{tmp_path.name.replace('-', '_')}"
    (tmp_path / f"{name}.py").write_text(FAKES)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.setenv("FAKE_PID", str(tmp_path / "pid"))
    yield f"{name}:FAKES"
    while apart._kept:
        apart._kept.pop().end()


def statuses(name: str, scans: list[Scan], registry: str, limit_s: float = 60.0) -> list[str]:
    table = measure_scans(name, scans, "00", limit_s, registry)
    assert table.column("name").to_pylist() == [scan.name for scan in scans]
    return table.column("status").to_pylist()


def test_a_good_codec_is_measured_as_in_this_process(fakes: str, street: Callable[..., Scan]) -> None:
    (row,) = measure_scans("good", [street()], "00", registry=fakes).to_pylist()
    assert row["status"] == "ok" and row["bit_exact"] and row["points_decoded"] == 3000
    assert row["bytes_total"] == 16 * 3000 + 1 and row["bytes_geometry"] == 12 * 3000 + 1


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("crash", "its process ended by signal SIGABRT"),
        ("leave", "its process ended with exit code 7"),
    ],
)
def test_a_crash_costs_its_rows(name: str, reason: str, fakes: str, street: Callable[..., Scan]) -> None:
    assert statuses(name, [street("0"), street("1")], fakes) == [f"failed: {reason}"] * 2
    assert statuses("good", [street()], fakes) == ["ok"]


def test_a_codec_that_hangs_is_ended_with_all_it_started(
    fakes: str, street: Callable[..., Scan], tmp_path: Path
) -> None:
    statuses("good", [street()], fakes)  # its process is there
    began = time.monotonic()
    assert statuses("hang", [street("0"), street("1")], fakes, limit_s=0.5) == [
        "failed: took more than 0.5 s for 1 scan",
        "failed: not tried again, took more than 0.5 s for 1 scan",
    ]
    assert time.monotonic() - began < 20
    time.sleep(0.2)
    state = Path(f"/proc/{(tmp_path / 'pid').read_text()}/stat")
    assert not state.exists() or state.read_text().split()[2] == "Z"
    assert statuses("good", [street()], fakes) == ["ok"]


def test_what_a_codec_prints_does_not_disturb(fakes: str, street: Callable[..., Scan]) -> None:
    assert statuses("talk", [street()], fakes) == ["ok"]


def test_memory_is_what_the_codec_takes(fakes: str, street: Callable[..., Scan]) -> None:
    (greedy,) = measure_scans("greedy", [street()], "00", registry=fakes).to_pylist()
    (good,) = measure_scans("good", [street()], "00", registry=fakes).to_pylist()
    if good["memory_mb"] is None:
        pytest.skip("this system does not tell the peak memory")
    assert 55 < greedy["memory_mb"] < 200
    assert good["memory_mb"] < 20
