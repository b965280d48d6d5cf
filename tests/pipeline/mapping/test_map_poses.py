"""Where scans were, in every way that one may say it: the map is the same."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import Writer
from numpy.typing import NDArray
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation

from salpcc.pipeline.mapping.map_plan import plan_map
from salpcc.pipeline.mapping.map_poses import given_poses
from salpcc.pipeline.run import RunRequest, run_sequences
from salpcc.schemas.config import RunConfig
from salpcc.schemas.errors import SourceError
from salpcc.schemas.messages import PLAIN, SCHEMA_TEXT, XYZI, CloudMessage
from salpcc.stages.mapping.drive.poses import read_poses
from salpcc.stages.residual_code.archive.reader import ArchiveReader

from .conftest import SCANS

SECOND = 10**9
START = 1_600_000_000 * SECOND


def planned(archive: Path, poses: Path | str) -> NDArray[np.float64]:
    return np.concatenate([group.given() for group in plan_map([archive], [str(poses)]).groups])


def test_every_format_says_the_same(archive: Path, poses: Path, made: Path, tmp_path: Path) -> None:
    truth = read_poses(poses)[:SCANS]
    np.testing.assert_allclose(planned(archive, poses), truth, atol=1e-12)
    reader = ArchiveReader(archive)
    times = [time for gop in range(len(reader.gops)) for time in reader.times(gop)]
    turns = Rotation.from_matrix(truth[:, :3, :3]).as_quat()
    lines = [
        f"{t / SECOND:.9f} " + " ".join(f"{v:.12f}" for v in (*p[:3, 3], *q))
        for t, p, q in zip(times, truth, turns, strict=True)
    ]
    (tmp_path / "poses.tum").write_text("\n".join(lines) + "\n")
    np.testing.assert_allclose(planned(archive, tmp_path / "poses.tum"), truth, atol=1e-6)
    np.testing.assert_allclose(planned(archive, made / "poses.txt"), _padded(made / "poses.txt"), atol=1e-9)


def _padded(path: Path) -> NDArray[np.float64]:
    out = np.tile(np.eye(4), (SCANS, 1, 1))
    out[:, :3] = np.loadtxt(path).reshape(-1, 3, 4)
    return out


def test_poses_of_another_map_or_clock_are_named(archive: Path, made: Path, tmp_path: Path) -> None:
    for name in ("poses.txt", "scans.txt"):
        shutil.copy(made / name, tmp_path / name)
    (tmp_path / "scans.txt").write_text("\n".join(f"{k:06d}" for k in range(5)) + "\n")
    with pytest.raises(SourceError, match=r"poses.txt: no pose of scan 000005"):
        planned(archive, tmp_path / "poses.txt")
    (tmp_path / "late.tum").write_text("1600000000 0 0 0 0 0 0 1\n1600000001 1 0 0 0 0 0 1\n")
    with pytest.raises(
        SourceError, match=r"late.tum: .* 10 of 10 scans are not in between, such as 000000 at 0.000 s"
    ):
        planned(archive, tmp_path / "late.tum")
    with pytest.raises(SourceError, match=r"/tf: no poses there; name a file of poses"):
        planned(archive, "/tf")


@pytest.fixture(scope="module")
def logged(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An archive of a log: three clouds, logged 80 ms after they were taken, among transforms."""
    root = tmp_path_factory.mktemp("logs")
    store = get_typestore(Stores.LATEST)
    kind = "tf2_msgs/msg/TFMessage"
    rng = np.random.default_rng(0)
    with open(root / "drive.mcap", "wb") as stream:
        writer = Writer(stream)
        writer.start("ros2", "test")
        text = store.generate_msgdef(kind, ros_version=2)[0].encode()
        schemas = {
            PLAIN: writer.register_schema(PLAIN, "ros2msg", SCHEMA_TEXT[PLAIN].encode()),
            kind: writer.register_schema(kind, "ros2msg", text),
        }
        channels = {
            topic: writer.register_channel(topic, "cdr", schemas[of])
            for topic, of in (("/points", PLAIN), ("/tf", kind), ("/tf_static", kind), ("/other", kind))
        }
        writer.add_message(
            channels["/tf_static"], START, _transform(START, "base", "lidar", (0, 0, 2.0)), START
        )
        for k in range(5):
            time = START + k * SECOND // 10
            writer.add_message(channels["/tf"], time, _transform(time, "map", "base", (k, 0, 0)), time)
            if k in (1, 2, 3):
                rows = rng.normal(0, 10, (200, 4)).astype("<f4")
                cloud = CloudMessage(
                    time + 50_000_000, "lidar", 200, rows.tobytes(), point_step=16, fields=XYZI
                )
                writer.add_message(channels["/points"], time + 80_000_000, cloud.to_cdr(), time)
        writer.finish()
    config = RunConfig(source="bag", keep_movable=True, effort="fast", gop=2)
    assert not run_sequences(RunRequest(config, ["drive"], root / "out", root, workers=0, quiet=True)).failed
    return root / "out" / "archives" / "drive.mcap"


def _transform(time: int, parent: str, child: str, place: tuple[float, ...]) -> bytes:
    types = get_typestore(Stores.LATEST).types
    stamp = types["builtin_interfaces/msg/Time"](sec=time // SECOND, nanosec=time % SECOND)
    x, y, z = map(float, place)
    one = types["geometry_msgs/msg/TransformStamped"](
        header=types["std_msgs/msg/Header"](stamp=stamp, frame_id=parent),
        child_frame_id=child,
        transform=types["geometry_msgs/msg/Transform"](
            translation=types["geometry_msgs/msg/Vector3"](x=x, y=y, z=z),
            rotation=types["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0),
        ),
    )
    message = types["tf2_msgs/msg/TFMessage"](transforms=[one])
    return bytes(get_typestore(Stores.LATEST).serialize_cdr(message, "tf2_msgs/msg/TFMessage"))


def test_transforms_of_a_log_are_taken_when_its_clouds_were(logged: Path) -> None:
    poses = given_poses("/tf", ArchiveReader(logged))
    np.testing.assert_allclose(poses[:, :3, 3], [[1.5, 0, 2], [2.5, 0, 2], [3.5, 0, 2]], atol=1e-6)


def test_topics_that_are_there_are_told(logged: Path) -> None:
    with pytest.raises(
        SourceError, match=r"/odom: no poses there; .*topic with poses of the log \(.*/tf, /tf_static\)"
    ):
        given_poses("/odom", ArchiveReader(logged))
