"""The examples run."""

import subprocess
import sys
from pathlib import Path

EXAMPLES = Path(__file__).parents[2] / "examples"


def run(*arguments: object) -> str:
    command = [sys.executable, *map(str, arguments)]
    result = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert result.returncode == 0, result.stderr
    return result.stdout


def test_encode_arrays() -> None:
    exact, bounded = run(EXAMPLES / "encode_arrays.py").splitlines()
    assert "largest error 0.0000 m" in exact
    assert 0 < float(bounded.split()[-2]) <= 0.01


def test_train_from_archives(tmp_path: Path, toy_root: Path) -> None:
    from salpcc.pipeline import encode_scans
    from salpcc.stages.ingest.sources import SOURCES

    source = SOURCES["semantickitti"]
    scans = [source.read(ref, with_labels=True) for ref in source.scans(toy_root, "00")]
    archive = encode_scans(scans, tmp_path / "00.mcap", labels="given", keep_movable=True, gop=2)
    assert "epoch 1: 5 scans" in run(EXAMPLES / "train_from_archives.py", archive)
