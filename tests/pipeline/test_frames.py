"""``decode --frame``: points as the sensor measured them, and when, in every format that has a place for it."""

from pathlib import Path

import laspy
import numpy as np
import pytest
from plyfile import PlyData
from rosbags.highlevel import AnyReader
from typer.testing import CliRunner

from salpcc.pipeline import Archive, encode_scans
from salpcc.pipeline.cli.app import app
from salpcc.pipeline.decode import turn_ns
from salpcc.schemas.errors import UsageError
from salpcc.schemas.scan import Scan
from salpcc.stages.ingest.sources import SOURCES
from salpcc.stages.residual_code.archive.reader import ArchiveReader


@pytest.fixture(scope="module")
def path(toy_root: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    source = SOURCES["semantickitti"]
    scans = [source.read(ref, True) for ref in source.scans(toy_root, "01")]  # 0, 1 and 7
    out = tmp_path_factory.mktemp("frames") / "01.mcap"
    return encode_scans(scans, out, "01", effort="fast", labels="given", keep_movable=False)


def decode(path: Path, *options: object) -> str:
    result = CliRunner().invoke(app, ["decode", str(path), *map(str, options)])
    assert result.exit_code == 0, result.output
    return result.output


def test_a_turn_takes_what_times_and_frame_numbers_say(path: Path, tmp_path: Path) -> None:
    assert turn_ns(ArchiveReader(path)) == 10**8  # 0.7 s from frame 0 to 7
    one = Scan("5", np.zeros((1, 3), np.float32), np.zeros(1, np.float32), 77)
    assert turn_ns(ArchiveReader(encode_scans([one], tmp_path / "a.mcap"))) == 10**8


def test_every_format_tells_when_a_point_was_measured(path: Path, tmp_path: Path) -> None:
    with Archive.open(path, frame="sensor") as archive:
        scans = list(archive)
        assert (archive[2].offset == scans[2].offset).all()
    for layers in ("all", "static"):
        with Archive.open(path, threads=2, frame="sensor", layers=layers) as archive:  # type: ignore[arg-type]
            assert all(len(scan.offset) == len(scan) and np.ptp(scan.offset) > 0.09e9 for scan in archive)
    decode(path, "--to", "ply", "--frame", "sensor", "--out", tmp_path)
    vertex = PlyData.read(tmp_path / "01" / "000001.ply")["vertex"]
    assert vertex["t"].dtype == np.int32 and (vertex["t"] == scans[1].offset).all()
    decode(path, "--to", "laz", "--frame", "sensor", "--out", tmp_path)
    las = laspy.read(tmp_path / "01" / "000001.laz")
    assert (las["t"] == scans[1].offset).all()
    assert np.abs(las.gps_time - (0.1 + scans[1].offset / 1e9)).max() < 1e-9
    decode(path, "--to", "mcap", "--frame", "sensor", "--out", tmp_path / "m")
    with AnyReader([tmp_path / "m" / "01"]) as reader:
        for scan, (connection, _, raw) in zip(scans, reader.messages(), strict=True):
            message = reader.deserialize(raw, connection.msgtype)
            assert message.point_step == 20 and [f.name for f in message.fields][-1] == "t"
            times = np.frombuffer(message.data, np.uint8).reshape(-1, 20)[:, 16:].copy().view("<i4")[:, 0]
            assert (times == scan.offset).all()
    said = decode(path, "--to", "kitti", "--frame", "sensor", "--out", tmp_path / "k")
    assert "when each was measured" in said


def test_wrong_frames_are_one_line(path: Path, tmp_path: Path) -> None:
    for frame, told in (("middle", "choose from"), ("start", "no motion")):
        result = CliRunner().invoke(
            app, ["decode", str(path), "--to", "ply", "--frame", frame, "--out", str(tmp_path)]
        )
        assert isinstance(result.exception, UsageError) and told in str(result.exception)
