"""What others read: MCAP PointCloud2, PLY, KITTI's files. LAZ is in test_laz_export."""

import shutil
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path

import laspy
import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from plyfile import PlyData
from rosbags.highlevel import AnyReader

from salpcc.pipeline import Archive, Scan, encode_scans
from salpcc.pipeline.export import EXPORTS
from salpcc.pipeline.run import RunResult
from salpcc.schemas.errors import UsageError
from salpcc.stages.ingest.sources import SOURCES
from salpcc.stages.mapping.open3d_library import load_open3d

from ..conftest import cloud_of

GOLDEN = Path(__file__).parents[2] / "golden" / "fast_exact.mcap"


@pytest.fixture
def archive(done: Path) -> Archive:
    return Archive.open(done / "archives" / "01.mcap")


def rows_of(scan: Scan) -> bytes:
    return np.column_stack([scan.points, scan.intensity]).astype("<f4").tobytes()


def test_point_cloud_messages_hold_every_bit(archive: Archive, tmp_path: Path) -> None:
    (path,) = EXPORTS["mcap"](archive, iter(archive), tmp_path)
    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        clouds = [(m.log_time, c) for _, _, m, c in reader.iter_decoded_messages()]
    for scan, (time, cloud) in zip(archive, clouds, strict=True):
        assert (time, cloud.width, cloud.height, cloud.point_step) == (scan.time, len(scan), 1, 16)
        assert bytes(cloud.data) == rows_of(scan)
    with AnyReader([path]) as bag:
        assert [c.msgtype for c, _, _ in bag.messages()] == ["sensor_msgs/msg/PointCloud2"] * 3


def test_ply_holds_every_bit_and_the_classes(tmp_path: Path) -> None:
    """The golden archive's first two scans have classes, the third has none."""
    archive = Archive.open(GOLDEN)
    paths = list(EXPORTS["ply"](archive, iter(archive), tmp_path))
    assert [scan.classes is not None for scan in archive] == [True, True, False]
    for scan, path in zip(archive, paths, strict=True):
        vertices = PlyData.read(path)["vertex"].data
        names = ["x", "y", "z", "intensity"] + ([] if scan.classes is None else ["class"])
        assert list(vertices.dtype.names) == names
        assert np.column_stack([vertices[name] for name in names[:4]]).tobytes() == rows_of(scan)
        if scan.classes is not None:
            assert vertices["class"].tobytes() == scan.classes.tobytes()


def test_ply_has_each_field_under_its_own_name(tmp_path: Path) -> None:
    """Two fields of one name, one named like what another would be called, one like our class, one of three numbers."""
    fields = {
        "x": "f8", "y": "f4", "z": "f4", "intensity": "u1", "second": "f4", "third": "i1", "class": "u2",
        "normal": "(3,)f4", "t ns": "i4",
    }  # fmt: skip
    rows = np.zeros(50, list(fields.items()))
    rng = np.random.default_rng(0)
    for name in ("x", "y", "z"):
        rows[name] = rng.normal(0, 10, 50)
    rows["x"] += 4_400_000.123  # float32 holds no such place to the millimetre
    rows["intensity"], rows["second"], rows["third"], rows["class"], rows["t ns"] = 7, 9, 11, 201, -5
    rows["normal"] = [1, 2, 3]
    scan = replace(
        cloud_of(rows, {"second": "intensity", "third": "intensity_1"}), classes=np.full(50, 15, np.uint8)
    )
    archive = Archive.open(encode_scans([scan], tmp_path / "a.mcap", labels="given", effort="fast"))
    (path,) = EXPORTS["ply"](archive, iter(archive), tmp_path)
    vertices = PlyData.read(path)["vertex"].data
    types = {name: vertices.dtype[name].str[1:] for name in vertices.dtype.names}
    assert types == {
        "x": "f8", "y": "f4", "z": "f4", "intensity": "u1", "intensity_2": "f4", "intensity_1": "i1", "class": "u2",
        "normal": "f4", "normal_1": "f4", "normal_2": "f4", "t_ns": "i4", "class_1": "u1",
    }  # fmt: skip
    assert all(vertices[axis].tobytes() == rows[axis].tobytes() for axis in "xyz")
    values = {"intensity": 7, "intensity_2": 9, "intensity_1": 11, "class": 201, "normal": 1, "normal_1": 2,
              "normal_2": 3, "t_ns": -5, "class_1": 15}  # fmt: skip
    assert {name: set(vertices[name].tolist()) for name in values} == {n: {v} for n, v in values.items()}


@pytest.mark.usefixtures("open3d")
def test_open3d_reads_the_ply(archive: Archive, tmp_path: Path) -> None:
    (path, *_) = EXPORTS["ply"](archive, iter(archive), tmp_path)
    points = np.asarray(load_open3d().io.read_point_cloud(str(path)).points)
    assert np.array_equal(points, archive[0].points)


def test_a_cloud_without_intensity_gets_none(tmp_path: Path) -> None:
    rows = np.zeros(20, [("x", "f4"), ("y", "f4"), ("z", "f4"), ("ring", "u2")])
    rows["x"], rows["ring"] = np.arange(20), np.arange(20) % 4
    archive = Archive.open(encode_scans([cloud_of(rows)], tmp_path / "a.mcap", effort="fast"))
    (path,) = EXPORTS["ply"](archive, iter(archive), tmp_path)
    assert PlyData.read(path)["vertex"].data.dtype.names == ("x", "y", "z", "ring")
    told: list[str] = []
    (path,) = EXPORTS["laz"](archive, iter(archive), tmp_path, told.append)
    assert told == ["intensity: none recorded"] and not laspy.read(path).intensity.any()


@pytest.mark.filterwarnings("error")
def test_infinite_points_reach_messages_in_silence(tmp_path: Path) -> None:
    points = np.array([[np.inf, 1, 2], [3, -np.inf, np.nan]], np.float32)
    archive = Archive.open(
        encode_scans([Scan("000000", points, np.zeros(2, np.float32))], tmp_path / "a.mcap")
    )
    (path,) = EXPORTS["mcap"](archive, iter(archive), tmp_path)
    with path.open("rb") as stream:
        ((_, _, _, cloud),) = make_reader(
            stream, decoder_factories=[DecoderFactory()]
        ).iter_decoded_messages()
    assert not cloud.is_dense and bytes(cloud.data) == rows_of(archive[0])


def test_weird_floats_reach_kitti_files(tmp_path: Path) -> None:
    bits = np.array([[0x7FC00001, 0xFF800000, 0x80000000, 0x7FA00000]] * 3, np.uint32)
    scan = Scan("000000", bits[:, :3].copy().view(np.float32), bits[:, 3].copy().view(np.float32))
    archive = Archive.open(encode_scans([scan], tmp_path / "a.mcap"))
    (path,) = EXPORTS["kitti"](archive, iter(archive), tmp_path)
    assert path.read_bytes() == bits.tobytes()


def test_kitti_files_are_the_ones_that_were_read(
    toy_root: Path, tmp_path: Path, run: Callable[..., RunResult]
) -> None:
    """Scans, classes, times: of a sequence with a gap, in two goes."""
    options = {"labels": "given", "side_files": False, "effort": "fast"}
    assert not run(toy_root, tmp_path / "out", "01", **options).failed
    archive = Archive.open(tmp_path / "out" / "archives" / "01.mcap")
    told: list[str] = []
    for part in (archive[:2], archive[2:]):
        assert len(list(EXPORTS["kitti"](archive, iter(part), tmp_path, told.append))) == len(part)
    source = SOURCES["semantickitti"]
    refs, back = source.scans(toy_root, "01"), source.scans(tmp_path, "01")
    assert [(ref.name, ref.time) for ref in refs] == [(ref.name, ref.time) for ref in back] and not told
    for ref, other in zip(refs, back, strict=True):
        assert Path(ref.path).read_bytes() == Path(other.path).read_bytes()
        classes = [source.read(r, with_labels=True).classes for r in (ref, other)]
        assert classes[0] is not None and np.array_equal(*classes)
    lines = (tmp_path / "sequences" / "01" / "times.txt").read_text().split("\n")
    assert lines == ["0.000000000", "0.100000000", "", "", "", "", "", "0.700000000", ""]


def test_labels_of_others_are_never_replaced(
    toy_root: Path, tmp_path: Path, run: Callable[..., RunResult]
) -> None:
    """A label file holds instances, an archive of classes alone does not."""
    options = {"labels": "given", "side_files": False, "effort": "fast"}
    assert not run(toy_root, tmp_path / "out", "01", **options).failed
    shutil.copytree(toy_root / "sequences" / "01", tmp_path / "sequences" / "01")
    archive = Archive.open(tmp_path / "out" / "archives" / "01.mcap")
    with pytest.raises(UsageError, match=r"000000\.label: other labels are there"):
        list(EXPORTS["kitti"](archive, iter(archive), tmp_path))
    for file in (toy_root / "sequences" / "01" / "labels").iterdir():
        assert (tmp_path / "sequences" / "01" / "labels" / file.name).read_bytes() == file.read_bytes()


def test_points_of_others_are_never_replaced(tmp_path: Path) -> None:
    """A part of the points, or points that are only near, must not take the place of the data they are of."""
    scan = Scan("000000", np.ones((3, 3), np.float32), np.zeros(3, np.float32))
    archive = Archive.open(encode_scans([scan], tmp_path / "a.mcap"))
    (path,) = EXPORTS["kitti"](archive, iter(archive), tmp_path)
    assert list(EXPORTS["kitti"](archive, iter(archive), tmp_path)) == [path]  # the same again is fine
    path.write_bytes(before := path.read_bytes() + bytes(16))
    with pytest.raises(UsageError, match=r"000000\.bin: other points are there; name an empty folder"):
        list(EXPORTS["kitti"](archive, iter(archive), tmp_path))
    assert path.read_bytes() == before


def test_times_of_a_log_keep_their_nanoseconds(tmp_path: Path) -> None:
    times = [1_533_151_603_547_590_123, 1_533_151_603_647_590_321]
    points, intensity = np.ones((4, 3), np.float32), np.zeros(4, np.float32)
    for names in (["000000", "000001"], ["front-000000", "rear-000000"]):
        scans = [Scan(name, points, intensity, time) for name, time in zip(names, times, strict=True)]
        archive = Archive.open(encode_scans(scans, tmp_path / f"{names[0]}.mcap", names[0], effort="fast"))
        list(EXPORTS["kitti"](archive, iter(archive), tmp_path))
        assert [ref.time for ref in SOURCES["semantickitti"].scans(tmp_path, names[0])] == times


def test_messages_tell_that_files_and_classes_stay(done: Path, tmp_path: Path) -> None:
    told: list[str] = []
    archive = Archive.open(done / "archives" / "01.mcap")
    list(EXPORTS["mcap"](archive, iter(archive), tmp_path, told.append))
    assert [line.partition(" stay")[0] for line in told] == [", ".join(archive.side), "classes and labels"]
    assert "--to kitti has" in told[0] and "--to ply has" in told[1]
    told.clear()
    list(EXPORTS["kitti"](archive, iter(archive), tmp_path, told.append))
    assert not told


def test_kitti_tells_how_far_it_rounds(tmp_path: Path) -> None:
    rows = np.zeros(9, [("x", "f8"), ("y", "f4"), ("z", "f8"), ("intensity", "u4")])
    rows["x"][3], rows["z"][4], rows["intensity"][5] = 1 + 2.0**-30, np.nan, 2**24 + 1
    archive = Archive.open(encode_scans([cloud_of(rows)], tmp_path / "a.mcap", effort="fast"))
    told: list[str] = []
    list(EXPORTS["kitti"](archive, iter(archive), tmp_path, told.append))
    assert [line for line in told if "rounded" in line] == [
        "KITTI's files hold float32: coordinates are rounded by up to 9.31e-10; --to ply has them",
        "KITTI's files hold float32: intensities are rounded by up to 1; --to ply has them",
    ]


def test_kitti_tells_what_its_files_have_no_place_for(tmp_path: Path) -> None:
    rows = np.zeros(20, [("x", "f4"), ("y", "f4"), ("z", "f4"), ("ring", "u2")])
    scan = replace(cloud_of(rows), name="1533151603547590123")
    archive = Archive.open(encode_scans([scan], tmp_path / "a.mcap", effort="fast"))
    told: list[str] = []
    assert len(list(EXPORTS["kitti"](archive, iter(archive), tmp_path, told.append))) == 1
    assert told == [
        "times.txt is left out: the names of these scans are no frame numbers",
        "KITTI's files hold x, y, z, intensity: ring stay behind; --to ply has them",
    ]


@pytest.mark.parametrize("form", ["ply", "laz", "kitti"])
def test_other_points_are_never_replaced(form: str, archive: Archive, tmp_path: Path) -> None:
    """What is there may be the recording, or all of what only a layer is written of now; the same again is no harm."""
    for _ in range(2):
        paths = list(EXPORTS[form](archive, iter(archive), tmp_path))
    before = paths[-1].read_bytes()
    shorter = [replace(scan, points=scan.points + 1) for scan in archive]
    with pytest.raises(UsageError, match="other points are there"):
        list(EXPORTS[form](archive, iter(shorter), tmp_path))
    assert paths[-1].read_bytes() == before


@pytest.mark.parametrize("there", ["01.mcap", "metadata.yaml"])
def test_a_log_is_never_replaced(there: str, archive: Archive, tmp_path: Path) -> None:
    """A folder of rosbag2 has the name of its archive; that its metadata told of another file would hide a .db3, too."""
    (tmp_path / "01").mkdir()
    (tmp_path / "01" / there).write_bytes(b"recorded")
    with pytest.raises(UsageError, match=f"{there}: exists, and may be the log itself"):
        list(EXPORTS["mcap"](archive, iter(archive), tmp_path))
    assert [path.read_bytes() for path in (tmp_path / "01").iterdir()] == [b"recorded"]


@pytest.mark.parametrize("form", sorted(EXPORTS.keys() - {"bag"}))
def test_a_full_disk_is_told_with_the_file(
    form: str, archive: Archive, tmp_path: Path, little_room: Callable[[], AbstractContextManager[None]]
) -> None:
    scans = list(archive)
    with little_room(), pytest.raises(OSError, match=f"File too large: '{tmp_path}"):
        list(EXPORTS[form](archive, iter(scans), tmp_path))
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]
