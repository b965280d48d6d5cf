"""The race: turns, what it counts, and that it catches a codec which breaks its promise."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from salpcc.schemas.scan import Scan
from salpcc.stages.evaluate.baselines.ours import Coded
from salpcc.stages.evaluate.studies import bench
from salpcc.stages.evaluate.studies.profile import LIBRARIES, profile


def runner(
    name: str, scans: list[Scan], log: list[str], shift: float = 0.0, error: float = 0.0
) -> bench.Runner:
    """A codec of 100 bytes a scan that moves every point by ``shift``."""

    def encode() -> list[Coded]:
        log.append(name)
        return [Coded(bytes(100), 60, 40, 0) for _ in scans]

    def decode(data: list[bytes]) -> list[Scan]:
        assert [len(d) for d in data] == [100] * len(scans)
        return [replace(scan, points=scan.points + np.float32(shift)) for scan in scans]

    return bench.Runner(name, error, encode, decode, bound=error)


def test_codecs_take_turns_and_the_first_round_is_not_counted(street: Callable[..., Scan]) -> None:
    scans, log = [street()], list[str]()
    runners = [runner("a", scans, log), runner("b", scans, log)]
    bench.race(runners, scans, rounds=3)
    assert log == ["a", "b"] * 4
    assert len(runners[0].encode_ms) == len(runners[1].decode_ms) == 3


def test_the_table_counts_every_byte_and_says_what_is_exact(street: Callable[..., Scan]) -> None:
    scans, log = [street(points=800), street(points=800, seed=1)], list[str]()
    runners = [runner("draco", scans, log, shift=0.25), runner("exact", scans, log)]
    bench.race(runners, scans, rounds=1)
    lines = bench.table(runners, scans).splitlines()
    assert "2 scans, 1,600 points" in lines[0]
    assert lines[2].split()[:3] == ["draco", "0.60", "1.00"]
    assert lines[2].split()[3] == f"{1e3 * runners[0].worst:.3f}"
    assert runners[0].worst == pytest.approx(0.25 * 3**0.5, rel=1e-4)
    assert "bit-exact" in lines[3] and lines[3].split()[6] == "1.00"


@pytest.mark.parametrize(("shift", "code"), [(0.001, 0), (0.1, 1)])
def test_a_broken_promise_is_an_exit_code(
    shift: float, code: int, street: Callable[..., Scan], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    scans = [street()]
    monkeypatch.setattr(bench, "_scans", lambda *_: scans)
    monkeypatch.setattr(bench, "_runners", lambda *_: [runner("x", scans, [], shift, error=0.01)])
    path = tmp_path / "bench.json"
    assert bench.main(["--rounds", "1", "--errors", "0.01", "--json", str(path)]) == code
    (row,) = json.loads(path.read_text())["rows"]
    assert row["codec"] == "x" and row["max_error_m"] == pytest.approx(shift * 3**0.5, rel=1e-2)
    assert row["bpp_total"] == pytest.approx(8 * 100 / 3000)


def test_a_missing_root_is_one_line(capsys: pytest.CaptureFixture[str], tmp_path: object) -> None:
    assert bench.main(["--root", str(tmp_path)]) == 1
    said = capsys.readouterr().err
    assert said.startswith("bench: ") and said.count("\n") == 1


def test_threads_and_profile(street: Callable[..., Scan], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bench, "decode_group", lambda data: iter(data))
    assert bench.threads_gain([Coded(b"", 0, 0, 0)], threads=2, rounds=3) > 0
    seconds = profile(lambda: np.sort(np.random.default_rng(0).random(1 << 20)))
    assert seconds[LIBRARIES] > 0 and not any(name.startswith("stages") for name in seconds)
    scan = street()
    seconds = profile(lambda: bench._same(scan, scan))
    assert "stages/evaluate/studies/bench" in seconds
