"""A second run reads no source file, and misses no change."""

import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from salpcc.pipeline.graph.graph import GraphOptions
from salpcc.pipeline.plan import digests
from salpcc.pipeline.run import RunResult
from salpcc.pipeline.verify import verify
from salpcc.schemas import marks
from salpcc.stages.ingest.sources import files

OVERWRITE = GraphOptions(overwrite=True)
Run = Callable[..., RunResult]


@pytest.fixture
def reads(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Names of the files that are read for their digests; all files are taken for old ones."""
    read: list[str] = []
    reading = files.reading
    monkeypatch.setattr(files, "reading", lambda path: read.append(path.name) or reading(path))
    read_side = digests.read_side
    monkeypatch.setattr(digests, "read_side", lambda ref: read.append(ref.name) or read_side(ref))
    monkeypatch.setattr(marks, "_REST", 0)
    return read


@pytest.fixture
def root(toy_root: Path, tmp_path: Path) -> Path:
    shutil.copytree(toy_root, tmp_path / "root")
    return tmp_path / "root"


def test_a_second_run_reads_no_file(root: Path, tmp_path: Path, run: Run, reads: list[str]) -> None:
    out = tmp_path / "out"
    names = [f"{number:06d}" for number in range(5)]
    run(root, out, "00", effort="fast")  # labels and side files, too
    beside = [f"{name}.label" for name in names] + ["times.txt"]
    assert sorted(reads) == sorted([*(f"{name}.bin" for name in names), *beside])
    reads.clear()
    run(root, out, "00", effort="fast")
    assert reads == []
    out = tmp_path / "without"
    for given in (False, True):
        options = {
            "effort": "fast",
            "side_files": False,
            **({"labels": "given", "keep_movable": False} if given else {}),
        }
        run(root, out, "00", graph=OVERWRITE, **options)  # the second time other options
        assert sorted(reads) == [f"{name}.label" if given else f"{name}.bin" for name in names]
        reads.clear()
        run(root, out, "00", **options)
        assert reads == []
    assert str(root) not in (out / "records" / "00.json").read_text()


def test_a_byte_that_changes_is_found_though_its_times_are_set_back(
    root: Path, tmp_path: Path, run: Run, reads: list[str]
) -> None:
    out = tmp_path / "out"
    run(root, out, "00", "01", effort="fast")
    scan = root / "sequences" / "00" / "velodyne" / "000002.bin"
    times, data = scan.stat(), bytearray(scan.read_bytes())
    data[12] ^= 1
    scan.write_bytes(data)
    os.utime(scan, ns=(times.st_atime_ns, times.st_mtime_ns))
    reads.clear()
    run(root, out, "00", "01", effort="fast", graph=OVERWRITE)
    assert set(reads) == {"000002.bin"}
    assert verify(out / "archives" / "00.mcap", root).bit_exact_scans == 5


def test_a_touched_file_is_read_once(root: Path, tmp_path: Path, run: Run, reads: list[str]) -> None:
    out = tmp_path / "out"
    run(root, out, "00", effort="fast")
    written = (out / "archives" / "00.mcap").stat().st_mtime_ns
    os.utime(root / "sequences" / "00" / "velodyne" / "000003.bin")
    for expected in (["000003.bin"], []):
        reads.clear()
        run(root, out, "00", effort="fast")
        assert reads == expected and (out / "archives" / "00.mcap").stat().st_mtime_ns == written


def test_what_changed_just_now_is_not_relied_on(
    root: Path, tmp_path: Path, run: Run, reads: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(marks, "_REST", 3600 * 10**9)
    out = tmp_path / "out"
    run(root, out, "00", effort="fast")
    assert json.loads((out / "records" / "00.json").read_text())["files"] == {}
    reads.clear()
    run(root, out, "00", effort="fast")
    assert len(reads) == 11
