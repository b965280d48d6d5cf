"""The adapter to tmc3, against a stand-in program that only copies files; the real one is used where it is."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from salpcc.schemas.scan import Scan
from salpcc.stages.evaluate.baselines import BASELINES
from salpcc.stages.evaluate.baselines.baseline import NotPossible
from salpcc.stages.evaluate.baselines.measure_baseline import measure
from salpcc.stages.evaluate.baselines.tmc13 import from_ply, to_ply

POINTS = np.array([[1.0, -2.0, 0.5], [-70.25, 3.0, -1.75]], np.float32)

COPY = """
import shutil, sys
asked = dict(option[2:].split("=", 1) for option in sys.argv[1:])
if asked["mode"] == "0":
    assert asked["disableAttributeCoding"] == "1"
    shutil.copy(asked["uncompressedDataPath"], asked["compressedStreamPath"])
else:
    shutil.copy(asked["compressedStreamPath"], asked["reconstructedDataPath"])
print("positions processing time (user): 0.5 s\\n\\nProcessing time (wall): 9 s\\nProcessing time (user): 1.25 s")
"""


def put(folder: Path, script: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Make ``tmc3`` on the PATH a Python script."""
    program = folder / "tmc3"
    program.write_text(f"#!{sys.executable}\n{script}")
    program.chmod(0o755)
    monkeypatch.setenv("PATH", str(folder))


@pytest.mark.parametrize("name", ["tmc13", "tmc13_octree", "tmc13_octree_angular"])
def test_points_go_through_the_program_and_back(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    put(tmp_path, COPY, monkeypatch)
    baseline = BASELINES[name]
    assert baseline.missing() is None
    assert np.array_equal(baseline.decode(baseline.encode(POINTS, 0.125)), POINTS)


def test_the_time_is_what_the_program_tells(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    put(tmp_path, COPY, monkeypatch)
    scan = Scan("000000", POINTS, np.zeros(2, np.float32))
    (row,) = measure("tmc13", BASELINES["tmc13"], [scan], "00", 0.125)
    assert row["status"] == "ok" and row["encode_ms"] == row["decode_ms"] == 1250


def test_the_program_may_be_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    put(tmp_path, COPY, monkeypatch)
    (tmp_path / "tmc3").rename(tmp_path / "tmc3-v23")
    assert BASELINES["tmc13"].missing()
    monkeypatch.setenv("SALPCC_TMC3", str(tmp_path / "tmc3-v23"))
    assert BASELINES["tmc13"].missing() is None
    assert len(BASELINES["tmc13"].encode(POINTS, 0.125)) > len(POINTS)


def test_what_the_program_says_when_it_fails_is_passed_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    put(tmp_path, "import sys; print('a\\nout of luck', file=sys.stderr); sys.exit(3)", monkeypatch)
    with pytest.raises(NotPossible, match="tmc3 failed: out of luck"):
        BASELINES["tmc13"].encode(POINTS, 0.01)


def test_without_the_program_the_row_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    assert BASELINES["tmc13"].missing() == "tmc3 not found"


def test_ply_round_trip_and_doubles_with_empty_faces() -> None:
    levels = np.array([[1, -2, 3], [1 << 20, 0, -7]], np.int32)
    assert np.array_equal(from_ply(to_ply(levels)), levels)
    head = (
        b"ply\nformat binary_little_endian 1.0\nelement vertex 2\nproperty float64 x\nproperty float64 y\n"
        b"property float64 z\nelement face 0\nproperty list uint8 int32 vertex_index\nend_header\n"
    )
    assert np.array_equal(from_ply(head + levels.astype("<f8").tobytes()), levels)
    with pytest.raises(NotPossible, match="expected vertices"):
        from_ply(head.replace(b" x\n", b" red\n") + levels.astype("<f8").tobytes())
