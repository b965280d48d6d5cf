"""Verification that can fail: it must find what is wrong, not only nod."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from salpcc.pipeline import encode_scans
from salpcc.pipeline.verify import verify
from salpcc.schemas.errors import UsageError
from salpcc.schemas.scan import Scan


@pytest.fixture
def root(toy_root: Path, tmp_path: Path) -> Path:
    shutil.copytree(toy_root, tmp_path / "root")
    return tmp_path / "root"


def test_good_archive_is_good(done: Path, root: Path) -> None:
    verdict = verify(done / "archives" / "00.mcap", root)
    assert verdict.good and (verdict.scans, verdict.bit_exact_scans, verdict.max_error_m) == (5, 5, 0.0)


@pytest.mark.parametrize("column", [0, 2, 3])
def test_one_changed_value_of_the_source_is_found(done: Path, root: Path, column: int) -> None:
    path = root / "sequences/00/velodyne/000003.bin"
    rows = np.fromfile(path, "<f4").reshape(-1, 4)
    rows[77, column] = np.nextafter(rows[77, column], np.float32(9))
    rows.tofile(path)
    verdict = verify(done / "archives" / "00.mcap", root)
    assert not verdict.good and verdict.bit_exact_scans == 4
    assert "000003" in verdict.problems[0]


def test_one_missing_point_is_found(done: Path, root: Path) -> None:
    path = root / "sequences/00/velodyne/000003.bin"
    path.write_bytes(path.read_bytes()[16:])
    verdict = verify(done / "archives" / "00.mcap", root)
    assert not verdict.good and "000003" in verdict.problems[0]


def test_swapped_points_are_found(done: Path, root: Path) -> None:
    path = root / "sequences/00/velodyne/000000.bin"
    rows = np.fromfile(path, "<f4").reshape(-1, 4)
    rows[[10, 11]] = rows[[11, 10]]
    rows.tofile(path)
    assert not verify(done / "archives" / "00.mcap", root).good


def test_missing_source_scan_is_found(done: Path, root: Path) -> None:
    (root / "sequences/00/velodyne/000002.bin").unlink()
    verdict = verify(done / "archives" / "00.mcap", root)
    assert verdict.problems == [f"scan 000002: not in {root}"]


def test_missing_root_and_arrays_are_wrong_use(done: Path, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="not found"):
        verify(done / "archives" / "00.mcap", tmp_path / "nowhere")
    scan = Scan("0", np.zeros((5, 3), np.float32), np.zeros(5, np.float32))
    with pytest.raises(UsageError, match="no files"):
        verify(encode_scans([scan], tmp_path / "a.mcap"), tmp_path)
