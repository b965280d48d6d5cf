"""The examples run."""

import os
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

from salpcc.pipeline import Archive

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


# Starts a job where it is submitted, and ends it when it is cancelled.
SBATCH = """#!/bin/sh
cp "$1" "$0.script"
setsid sh "$0.script" > "$0.log" 2>&1 < /dev/null &
echo $! > "$0.pid"
echo "Submitted batch job $!"
"""
SCANCEL = """#!/bin/sh
for job in "$@"; do kill -TERM -- "-$job"; done
"""


def test_slurm_cluster(tmp_path: Path, toy_root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The whole example, with a machine of its own for a cluster."""
    pytest.importorskip("dask_jobqueue")
    for name, text in (("sbatch", SBATCH), ("scancel", SCANCEL)):
        (tmp_path / name).write_text(text)
        (tmp_path / name).chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    options = ["--keep-movable", "--effort=fast", "--gop=2", "--jobs=1", "--cores=1"]
    run(EXAMPLES / "slurm_cluster.py", "01", "--root", toy_root, "--out", tmp_path / "out", *options)
    with Archive.open(tmp_path / "out" / "archives" / "01.mcap") as archive:
        assert archive.names == ["000000", "000001", "000007"]
    assert "#SBATCH --cpus-per-task=1\n" in (tmp_path / "sbatch.script").read_text()
    job = int((tmp_path / "sbatch.pid").read_text())
    deadline = time.monotonic() + 30
    while alive(job) and time.monotonic() < deadline:
        time.sleep(0.1)
    assert not alive(job)  # it was cancelled


def alive(process: int) -> bool:
    try:
        return psutil.Process(process).status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False
