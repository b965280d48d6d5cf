"""The adapter to Cloudini's converter, against a stand-in program that only copies files."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from salpcc.stages.evaluate.baselines import BASELINES
from salpcc.stages.evaluate.baselines.cloudini import PROGRAM
from salpcc.stages.evaluate.baselines.contract import NotPossible

POINTS = np.array([[1.0, -2.0, 0.5], [-70.25, 3.0, -1.75]], np.float32)
COPY = """
import shutil, sys
assert ("--compress" in sys.argv) != ("--decode" in sys.argv)
if "--compress" in sys.argv:
    assert sys.argv[sys.argv.index("--resolution") + 1] == "0.02"
shutil.copy(sys.argv[sys.argv.index("--filename") + 1], sys.argv[sys.argv.index("--output") + 1])
"""


def put(folder: Path, script: str, monkeypatch: pytest.MonkeyPatch) -> None:
    program = folder / PROGRAM
    program.write_text(f"#!{sys.executable}\n{script}")
    program.chmod(0o755)
    monkeypatch.setenv("PATH", str(folder))


def test_points_go_through_the_program_and_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    put(tmp_path, COPY, monkeypatch)
    cloudini = BASELINES["cloudini"]
    assert cloudini.missing() is None
    data = cloudini.encode(POINTS, 0.01)
    assert len(data) < 300  # the message, not the file
    assert np.array_equal(cloudini.decode(data), POINTS)


def test_what_the_program_says_when_it_fails_is_passed_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    put(tmp_path, "import sys; print('no such topic', file=sys.stderr); sys.exit(1)", monkeypatch)
    with pytest.raises(NotPossible, match="failed: no such topic"):
        BASELINES["cloudini"].encode(POINTS, 0.01)
