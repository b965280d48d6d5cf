"""Poses of a log: along its transforms to the sensor, or of a topic, in ROS 1 and ROS 2."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from scipy.spatial.transform import Rotation

from salpcc.schemas.errors import LogWarning, SourceError
from salpcc.schemas.log import LogChannel, LogMessage
from salpcc.stages.mapping.drive.logged_poses import poses_in_log

SECOND = 10**9
START = 1_600_000_000 * SECOND
TF, ODOMETRY, POSE = "tf2_msgs/msg/TFMessage", "nav_msgs/msg/Odometry", "geometry_msgs/msg/PoseStamped"
LEVER = ((0.5, 0.1, 1.7), Rotation.from_euler("z", 90, degrees=True).as_quat())


def pose_at(seconds: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    return np.array([10 * seconds, 0, 0]), Rotation.from_euler("z", 0.2 * seconds).as_quat()


def matrix(place: Any, turn: Any) -> NDArray[np.float64]:
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = Rotation.from_quat(turn).as_matrix(), place
    return out


class Recorder:
    """A log in one of the two kinds of ROS, by topics."""

    def __init__(self, ros: int) -> None:
        self.store = get_typestore(Stores.ROS1_NOETIC if ros == 1 else Stores.LATEST)
        if TF not in self.store.types:
            self.store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", TF))
        self.ros, self.channels, self.messages = ros, dict[int, LogChannel](), list[LogMessage]()

    def make(self, name: str, **fields: Any) -> Any:
        return self.store.types[name](**fields)

    def header(self, time: int, frame: str) -> Any:
        stamp = self.make("builtin_interfaces/msg/Time", sec=time // SECOND, nanosec=time % SECOND)
        return self.make(
            "std_msgs/msg/Header", stamp=stamp, frame_id=frame, **({"seq": 0} if self.ros == 1 else {})
        )

    def placed(self, kind: str, place: Any, turn: Any) -> Any:
        names = ("translation", "rotation") if kind == "Transform" else ("position", "orientation")
        point = self.make(
            f"geometry_msgs/msg/{'Vector3' if kind == 'Transform' else 'Point'}",
            **dict(zip("xyz", map(float, place), strict=True)),
        )
        quaternion = self.make(
            "geometry_msgs/msg/Quaternion", **dict(zip("xyzw", map(float, turn), strict=True))
        )
        return self.make(f"geometry_msgs/msg/{kind}", **dict(zip(names, (point, quaternion), strict=True)))

    def transform(self, topic: str, time: int, parent: str, child: str, place: Any, turn: Any) -> None:
        one = self.make(
            "geometry_msgs/msg/TransformStamped", header=self.header(time, parent), child_frame_id=child,
            transform=self.placed("Transform", place, turn),
        )  # fmt: skip
        self.add(topic, TF, self.make(TF, transforms=[one]))

    def odometry(self, time: int, child: str) -> None:
        still = np.zeros(36)
        zero = self.make("geometry_msgs/msg/Vector3", x=0.0, y=0.0, z=0.0)
        twist = self.make("geometry_msgs/msg/Twist", linear=zero, angular=zero)
        pose = self.placed("Pose", *pose_at((time - START) / SECOND))
        message = self.make(
            ODOMETRY, header=self.header(time, "odom"), child_frame_id=child,
            pose=self.make("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=still),
            twist=self.make("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=still),
        )  # fmt: skip
        self.add("/odom", ODOMETRY, message)

    def add(self, topic: str, kind: str, message: Any) -> None:
        known = {channel.topic: channel for channel in self.channels.values()}
        name = kind.replace("/msg/", "/") if self.ros == 1 else kind
        encoding = "ros1" if self.ros == 1 else "cdr"
        new = LogChannel(len(known) + 1, topic, encoding, name, "", b"")
        channel = known.get(topic) or self.channels.setdefault(new.id, new)
        write = self.store.serialize_ros1 if self.ros == 1 else self.store.serialize_cdr
        self.messages.append(LogMessage(channel.id, 0, 0, 0, bytes(write(message, kind))))

    def poses(self, topic: str, frame: str, times: list[int]) -> NDArray[np.float64]:
        names = [f"{k:06d}" for k in range(len(times))]
        return poses_in_log(topic, self.channels, self.messages, frame, times, names)


@pytest.fixture(params=[1, 2])
def log(request: pytest.FixtureRequest) -> Recorder:
    """A drive of two seconds: map to odom stands for most of it, base moves in odom, the sensor is fixed to base."""
    log = Recorder(request.param)
    log.transform("/tf_static", START, "/base", "/lidar" if log.ros == 1 else "lidar", *LEVER)
    for k in range(21):
        time = START + k * SECOND // 10
        log.transform("/tf", time, "odom", "base", *pose_at(k / 10))
        log.odometry(time, "base")
        if k % 5 == 0:
            log.transform("/tf", time, "map", "odom", (100.0, 0, 0), (0, 0, 0, 1))
    return log


WANTED = [START + t for t in (0, 330_000_000, 1_250_000_000, 2 * SECOND)]


def expected(offset: float) -> NDArray[np.float64]:
    lever = matrix(*LEVER)
    out = np.array([matrix(*pose_at((t - START) / SECOND)) @ lever for t in WANTED])
    out[:, 0, 3] += offset
    return out


def test_transforms_lead_from_their_root_to_the_sensor(log: Recorder) -> None:
    np.testing.assert_allclose(log.poses("/tf", "lidar", WANTED), expected(100.0), atol=1e-6)


def test_odometry_leads_to_the_sensor_by_static_transforms(log: Recorder) -> None:
    np.testing.assert_allclose(log.poses("/odom", "lidar", WANTED), expected(0.0), atol=1e-6)


def test_poses_of_no_frame_are_the_sensors_with_a_warning(log: Recorder) -> None:
    for k in range(21):
        stamped = log.make(
            POSE,
            header=log.header(START + k * SECOND // 10, "map"),
            pose=log.placed("Pose", *pose_at(k / 10)),
        )
        log.add("/pose", POSE, stamped)
    with pytest.warns(LogWarning, match="its poses are taken for the sensor's"):
        found = log.poses("/pose", "lidar", WANTED)
    np.testing.assert_allclose(found, [matrix(*pose_at((t - START) / SECOND)) for t in WANTED], atol=1e-6)


def test_what_tells_no_poses_is_named(log: Recorder) -> None:
    with pytest.raises(
        SourceError, match=r"/tf: no transform of camera, .*; there are those of base, lidar, odom"
    ):
        log.poses("/tf", "camera", WANTED)
    with pytest.raises(
        SourceError, match=r"/tf odom to base: poses from .*, 1 of 1 scans are not in between"
    ):
        log.poses("/tf", "lidar", [START + 9 * SECOND])
    text = log.make("std_msgs/msg/String", data="no pose")
    log.add("/text", "std_msgs/msg/String", text)
    with pytest.raises(SourceError, match=r"/text: messages of std_msgs/msg/String; poses are in tf2_msgs"):
        log.poses("/text", "lidar", WANTED)
    with pytest.raises(SourceError, match=r"all transforms from base to lidar are static"):
        log.poses("/tf_static", "lidar", WANTED)
    log.messages.insert(
        0, LogMessage(next(c.id for c in log.channels.values() if c.topic == "/tf"), 7, 7, 0, b"torn")
    )
    with pytest.raises(SourceError, match=r"/tf: a message at 7 ns is no tf2_msgs"):
        log.poses("/tf", "lidar", WANTED)


def test_transforms_in_a_circle_end(log: Recorder) -> None:
    log.transform("/tf", START, "base", "map", (0, 0, 0), (0, 0, 0, 1))
    with pytest.raises(SourceError, match="transforms go round in a circle at base"):
        log.poses("/tf", "lidar", [START])
