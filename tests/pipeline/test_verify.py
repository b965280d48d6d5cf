"""Verification that can fail: it must find what is wrong, not only nod."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from salpcc.pipeline import encode_scans
from salpcc.pipeline.edit.cut import Selection, cut
from salpcc.pipeline.edit.merge import merge
from salpcc.pipeline.verify import verify
from salpcc.schemas.errors import UsageError
from salpcc.schemas.scan import Scan
from salpcc.stages.residual_code.archive.reader import ArchiveReader


@pytest.fixture
def root(toy_root: Path, tmp_path: Path) -> Path:
    shutil.copytree(toy_root, tmp_path / "root")
    return tmp_path / "root"


@pytest.mark.parametrize("threads", [1, 3])
def test_a_damaged_gop_leaves_the_others_verified(done: Path, tmp_path: Path, threads: int) -> None:
    archive = done / "archives" / "00.mcap"
    whole, reader = verify(archive, threads=threads), ArchiveReader(archive)
    payload = reader.payloads(1)[0].data
    data = bytearray(archive.read_bytes())
    data[data.index(payload) + len(payload) // 2] ^= 1
    bad = tmp_path / "00.mcap"
    bad.write_bytes(data)
    verdict = verify(bad, threads=threads)
    assert any("GOP 1" in problem for problem in verdict.problems)
    assert verdict.scans == whole.scans - len(reader.gops[1])


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


def test_scans_that_an_archive_lacks_are_said(done: Path, root: Path, tmp_path: Path) -> None:
    """Whoever reads "ok" may delete the source. A part of an archive is sound, so this is no problem of it."""
    parts = [tmp_path / "0.mcap", tmp_path / "2.mcap"]
    for part in parts:
        cut(done / "archives" / "00.mcap", part, Selection(frames=(int(part.stem), int(part.stem) + 1)))
    merge(parts, tmp_path / "gap.mcap")
    verdict = verify(tmp_path / "gap.mcap", root)
    assert verdict.good and verdict.scans_elsewhere == ["000001", "000003", "000004"]


def test_missing_root_and_arrays_are_wrong_use(done: Path, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"nowhere not found.* Pass its place to --against$"):
        verify(done / "archives" / "00.mcap", tmp_path / "nowhere")
    scan = Scan("0", np.zeros((5, 3), np.float32), np.zeros(5, np.float32))
    with pytest.raises(UsageError, match="no files"):
        verify(encode_scans([scan], tmp_path / "a.mcap"), tmp_path)
