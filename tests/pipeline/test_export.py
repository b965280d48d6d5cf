"""What others read: MCAP PointCloud2, PLY, LAZ."""

from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader

from salpcc.pipeline import Archive, Scan, encode_scans
from salpcc.pipeline.export import EXPORTS, LAZ_SCALE


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
    archive = Archive.open(Path(__file__).parents[1] / "golden" / "fast_exact.mcap")
    paths = list(EXPORTS["ply"](archive, iter(archive), tmp_path))
    assert [scan.classes is not None for scan in archive] == [True, True, False]
    for scan, path in zip(archive, paths, strict=True):
        head, _, body = path.read_bytes().partition(b"end_header\n")
        assert f"element vertex {len(scan)}\n".encode() in head
        assert (b"property uchar class\n" in head) == (scan.classes is not None)
        columns = [("xyzi", "<f4", 4)] + ([] if scan.classes is None else [("class", "u1")])
        rows = np.frombuffer(body, columns)
        assert rows["xyzi"].tobytes() == rows_of(scan)
        if scan.classes is not None:
            assert rows["class"].tobytes() == scan.classes.tobytes()


def test_laz_is_within_its_rounding(archive: Archive, tmp_path: Path) -> None:
    laspy = pytest.importorskip("laspy")
    pytest.importorskip("lazrs")
    (path, *_) = EXPORTS["laz"](archive, iter(archive), tmp_path)
    las = laspy.read(path)
    assert np.abs(np.asarray(las.xyz) - archive[0].points).max() <= LAZ_SCALE / 2 + 1e-9


def test_weird_floats_reach_kitti_files(tmp_path: Path) -> None:
    bits = np.array([[0x7FC00001, 0xFF800000, 0x80000000, 0x7FA00000]] * 3, np.uint32)
    scan = Scan("000000", bits[:, :3].copy().view(np.float32), bits[:, 3].copy().view(np.float32))
    archive = Archive.open(encode_scans([scan], tmp_path / "a.mcap"))
    (path,) = EXPORTS["kitti"](archive, iter(archive), tmp_path)
    assert path.read_bytes() == bits.tobytes()
