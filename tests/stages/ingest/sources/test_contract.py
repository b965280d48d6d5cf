"""What every source promises, on each of them."""

import hashlib
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from salpcc.schemas import marks
from salpcc.schemas.config import RunConfig
from salpcc.schemas.errors import SourceError
from salpcc.schemas.work import ScanRef
from salpcc.stages.ingest.sources import SOURCES
from salpcc.stages.ingest.sources.velodyne_bin import points_to_bytes

Layout = Callable[[Path, Path], tuple[Path, str, Path]]


def semantickitti(toy: Path, tmp: Path) -> tuple[Path, str, Path]:
    """Lay the toy sequence out; return root, sequence and the folder of its scans."""
    shutil.copytree(toy / "sequences" / "01", tmp / "sequences" / "01")
    return tmp, "01", tmp / "sequences" / "01" / "velodyne"


def kitti_raw(toy: Path, tmp: Path) -> tuple[Path, str, Path]:
    folder = tmp / "drive_sync" / "velodyne_points" / "data"
    shutil.copytree(toy / "sequences" / "01" / "velodyne", folder)
    return tmp, "drive_sync", folder


LAYOUTS: dict[str, Layout] = {
    "semantickitti": semantickitti,
    "simulated": semantickitti,
    "kitti_raw": kitti_raw,
}


# Not bag: its scans are messages of one file (test_mcap_log.py, tests/pipeline/test_logs.py).
@pytest.fixture(params=sorted(LAYOUTS.keys() & SOURCES.keys()))
def case(request: pytest.FixtureRequest, toy_root: Path, tmp_path: Path) -> tuple[str, Path, str, Path]:
    return (request.param, *LAYOUTS[request.param](toy_root, tmp_path))


Case = tuple[str, Path, str, Path]


def test_lists_sequences_and_scans_in_order(case: Case) -> None:
    name, root, sequence, _ = case
    assert SOURCES[name].name == name
    assert SOURCES[name].sequences(root) == [sequence]
    refs = SOURCES[name].scans(root, sequence)
    assert [ref.number for ref in refs] == [0, 1, 7]  # the gap stays
    assert [ref.time for ref in refs] == [0, 100_000_000, 700_000_000]


def test_reads_every_bit_in_file_order(case: Case) -> None:
    name, root, sequence, folder = case
    for ref in SOURCES[name].scans(root, sequence):
        scan = SOURCES[name].read(ref, with_labels=False)
        assert scan.points.dtype == scan.intensity.dtype == np.float32
        assert scan.name == ref.name and scan.time == ref.time
        assert points_to_bytes(scan.points, scan.intensity) == (folder / f"{ref.name}.bin").read_bytes()


def test_nan_bits_survive(case: Case) -> None:
    name, root, sequence, folder = case
    weird = np.array([0x7FA00001, 0xFFC12345, 0x80000000, 0x7F800000] * 3, "<u4").tobytes()
    (folder / "000001.bin").write_bytes(weird)
    scan = SOURCES[name].read(SOURCES[name].scans(root, sequence)[1], with_labels=False)
    assert points_to_bytes(scan.points, scan.intensity) == weird


def test_empty_file_is_a_scan_without_points(case: Case) -> None:
    name, root, sequence, folder = case
    (folder / "000001.bin").write_bytes(b"")
    assert len(SOURCES[name].read(SOURCES[name].scans(root, sequence)[1], with_labels=False)) == 0


@pytest.mark.parametrize("size", [1, 15, 17, 1000001])
def test_truncated_file_is_refused_by_name(case: Case, size: int) -> None:
    name, root, sequence, folder = case
    (folder / "000001.bin").write_bytes(bytes(size))
    with pytest.raises(SourceError, match=r"000001\.bin: truncated.*16"):
        SOURCES[name].read(SOURCES[name].scans(root, sequence)[1], with_labels=False)


def test_missing_file_is_refused_by_name(case: Case) -> None:
    name, root, sequence, folder = case
    ref = SOURCES[name].scans(root, sequence)[0]
    (folder / "000000.bin").unlink()
    with pytest.raises(SourceError, match=r"000000\.bin"):
        SOURCES[name].read(ref, with_labels=False)


def test_missing_sequence_says_where_data_come_from(case: Case) -> None:
    name, root, _, _ = case
    with pytest.raises(SourceError, match=r"nowhere.*expected ROOT|nowhere.*simulate"):
        SOURCES[name].scans(root, "nowhere")


def test_labels_asked_for_but_absent_are_refused(case: Case) -> None:
    name, _, _, folder = case
    ref = ScanRef("000000", 0, str(folder / "000000.bin"), 0, None)
    with pytest.raises(SourceError, match="--labels network"):
        SOURCES[name].read(ref, with_labels=True)


def test_digests_hold_until_a_file_changes(case: Case, monkeypatch: pytest.MonkeyPatch) -> None:
    name, root, sequence, folder = case
    monkeypatch.setattr(marks, "_REST", 0)  # as if the files were old
    source, config = SOURCES[name], RunConfig(source=name)  # type: ignore[arg-type]
    refs = source.asked(root, sequence, config, {})
    told, known = source.digest(refs[0], with_labels=False)
    assert told == [hashlib.sha256((folder / "000000.bin").read_bytes()).hexdigest()]
    assert source.recall(refs, known, config) == ({refs[0].path: told[0]}, known)
    assert source.recall(refs, {}, config) == ({}, {})
    (folder / "000000.bin").write_bytes(b"")
    assert source.recall(refs, known, config) == ({}, {})


def test_nothing_passes_through_beside_files(case: Case) -> None:
    name, root, sequence, _ = case
    source = SOURCES[name]
    assert source.there(root) and not source.there(root / "nowhere") and not source.passes
    refs = source.scans(root, sequence)
    assert source.passing(refs, (), None) is None and source.places(refs) == {}
