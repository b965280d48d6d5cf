"""What is particular to one source."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from salpcc.schemas.errors import SourceError
from salpcc.schemas.labels import CLASSES
from salpcc.stages.ingest.sources import SOURCES
from salpcc.stages.ingest.sources.kitti_raw import read_timestamps
from salpcc.stages.ingest.sources.semantickitti import read_times
from salpcc.stages.ingest.sources.simulated import Simulated

LABELS = np.array([10, 40, 50, 70, 252], np.uint32)


def test_labels_give_classes_by_their_lower_half(toy_root: Path) -> None:
    source = SOURCES["semantickitti"]
    ref = source.scans(toy_root, "00")[2]
    scan = source.read(ref, with_labels=True)
    assert scan.classes is not None and ref.labels is not None
    raw = np.fromfile(ref.labels, np.uint32) & 0xFFFF
    names = {10: "car", 252: "car", 40: "road", 50: "building", 70: "vegetation"}
    assert [CLASSES[c].name for c in scan.classes[:50]] == [names[int(r)] for r in raw[:50]]


@pytest.mark.parametrize("content", [b"\x00" * 8, np.full(4, 77, np.uint32).tobytes()])
def test_labels_that_do_not_fit_are_refused(toy_root: Path, tmp_path: Path, content: bytes) -> None:
    shutil.copytree(toy_root / "sequences" / "00", tmp_path / "sequences" / "00")
    (tmp_path / "sequences/00/velodyne/000000.bin").write_bytes(bytes(64))
    (tmp_path / "sequences/00/labels/000000.label").write_bytes(content)
    source = SOURCES["semantickitti"]
    with pytest.raises(SourceError, match=r"000000\.label"):
        source.read(source.scans(tmp_path, "00")[0], with_labels=True)


def test_a_plain_folder_of_bins_will_do(tmp_path: Path) -> None:
    (tmp_path / "single").mkdir()
    (tmp_path / "single" / "example.bin").write_bytes(bytes(32))
    refs = SOURCES["kitti_raw"].scans(tmp_path, "single")
    assert [(ref.name, ref.number) for ref in refs] == [("example", 0)]


def test_drives_may_lie_in_the_folder_of_their_day(tmp_path: Path) -> None:
    folder = tmp_path / "2011_09_26" / "2011_09_26_drive_0001_sync" / "velodyne_points" / "data"
    folder.mkdir(parents=True)
    (folder / "0000000003.bin").write_bytes(bytes(16))
    assert SOURCES["kitti_raw"].scans(tmp_path, "2011_09_26_drive_0001_sync")[0].number == 3


def test_timestamps_keep_their_nanoseconds(tmp_path: Path) -> None:
    path = tmp_path / "timestamps.txt"
    path.write_text("2011-09-26 13:02:25.951199337\n2011-09-26 13:02:26.054\n")
    assert read_timestamps(path) == [0, 102_800_663]
    path.write_text("yesterday\n")
    with pytest.raises(SourceError, match=r"timestamps\.txt"):
        read_timestamps(path)


@pytest.mark.parametrize("time", ["inf", "nan", "-1", "1e300", "soon"])
def test_impossible_times_are_refused(tmp_path: Path, time: str) -> None:
    path = tmp_path / "times.txt"
    path.write_text(f"0.1\n{time}\n")
    with pytest.raises(SourceError, match=r"times\.txt"):
        read_times(path)


def test_simulation_is_made_once_and_the_same(tmp_path: Path) -> None:
    source = Simulated()
    first = source.make(tmp_path / "a", "03", 1)
    made = Path(first[0].path).stat().st_mtime_ns
    assert source.make(tmp_path / "a", "03") == first and Path(first[0].path).stat().st_mtime_ns == made
    other = source.make(tmp_path / "b", "03", 1)
    assert Path(other[0].path).read_bytes() == Path(first[0].path).read_bytes()
    assert source.read(first[0], with_labels=True).classes is not None
    assert not list((tmp_path / "a").glob(".simulating*"))
