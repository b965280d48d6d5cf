"""Compiled kernels are those of the sources: a change in any file of the stages makes them anew."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from rich.console import Console

from salpcc.pipeline.schedule import progress

ROOT = Path(__file__).parents[2]
SCRIPT = "import salpcc.stages, numba; print(numba.config.CACHE_DIR)"


def folder(sources: Path, **more: str) -> str:
    environment = {k: v for k, v in os.environ.items() if k != "NUMBA_CACHE_DIR"}
    environment |= {"PYTHONPATH": str(sources), **more}
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT], env=environment, capture_output=True, text=True, check=True
    )
    return done.stdout.strip()


def test_another_source_is_another_folder(tmp_path: Path) -> None:
    copy = tmp_path / "salpcc"
    for room in ("schemas", "stages"):
        shutil.copytree(ROOT / room, copy / room, ignore=shutil.ignore_patterns("__pycache__", "weights"))
    shutil.copy(ROOT / "src" / "salpcc" / "__init__.py", copy)  # else an installed package would come first
    first = folder(tmp_path, XDG_CACHE_HOME=str(tmp_path))
    assert first.startswith(str(tmp_path / "salpcc-pipeline" / "kernels-"))
    assert folder(tmp_path, XDG_CACHE_HOME=str(tmp_path)) == first
    with open(copy / "stages" / "entropy" / "range_coder.py", "a") as source:
        source.write("\n")
    assert folder(tmp_path, XDG_CACHE_HOME=str(tmp_path)) != first


def test_a_folder_that_is_set_stays(tmp_path: Path) -> None:
    assert folder(ROOT / "src", NUMBA_CACHE_DIR=str(tmp_path)) == str(tmp_path)


def test_a_user_without_a_home_has_it_among_temporary_files(tmp_path: Path) -> None:
    """Not where others could put kernels of their own: these are code."""
    (tmp_path / "file").touch()
    temporary = tmp_path / "tmp"
    temporary.mkdir()
    for nowhere in (str(tmp_path / "file" / "cache"), "~/.cache"):
        found = folder(ROOT / "src", XDG_CACHE_HOME=nowhere, TMPDIR=str(temporary))
        own = temporary / f"salpcc-pipeline-{os.getuid()}"
        assert Path(found).parent == own and own.stat().st_mode & 0o777 == 0o700
    own.chmod(0o777)
    other = Path(folder(ROOT / "src", XDG_CACHE_HOME=nowhere, TMPDIR=str(temporary))).parent
    assert other.parent == temporary and other != own and other.stat().st_mode & 0o777 == 0o700
    own.rmdir()
    own.symlink_to(tmp_path)
    other = Path(folder(ROOT / "src", XDG_CACHE_HOME=nowhere, TMPDIR=str(temporary))).parent
    assert other.parent == temporary and other != own


def test_the_first_run_says_that_it_compiles(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(progress, "STDERR", Console(width=200))
    with progress.bar(1, "scans"):
        pass
    assert capsys.readouterr().out.count("compiles its kernels") == 1
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "kernel.1.nbc").write_bytes(b"")
    with progress.bar(1, "scans"):
        pass
    assert "compiles" not in capsys.readouterr().out
