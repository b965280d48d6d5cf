"""Poses that a log holds: of transforms (``/tf`` with ``/tf_static``), or of a topic with odometry or poses."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from salpcc.schemas.errors import LogWarning, SourceError
from salpcc.schemas.log import LogChannel, LogMessage
from salpcc.stages.mapping.drive.poses import inverse
from salpcc.stages.mapping.drive.trajectory import Trajectory

F64 = NDArray[np.float64]
Edge = tuple[str, str]  # parent, child

STATIC = "/tf_static"
_TRANSFORMS = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
_POSES = (
    "nav_msgs/msg/Odometry",
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
)


@dataclass(frozen=True)
class Stamped:
    """A pose as a message has it: of ``child`` in ``parent``; the child is empty where the message names none."""

    parent: str
    child: str
    time: int
    place: tuple[float, float, float]
    quaternion: tuple[float, float, float, float]


def poses_in_log(
    topic: str,
    channels: Mapping[int, LogChannel],
    messages: Iterable[LogMessage],
    frame: str,
    times: list[int],
    names: list[str],
) -> F64:
    """Return where the sensor, whose frame is ``frame``, was at ``times``: ``(n, 4, 4)``.

    Transforms lead from their root to the sensor. A topic of poses is of the frame that its messages name, from which static
    transforms lead to the sensor; where none do, it is taken for the sensor's own, with a warning.

    Raises:
        SourceError: the topic's messages are no poses; no transforms lead to the sensor, or they do not cover a scan.
    """
    wanted = {channel.id: channel for channel in channels.values() if channel.topic in (topic, STATIC)}
    kinds = {_type(channel) for channel in wanted.values() if channel.topic == topic}
    if not kinds <= {*_TRANSFORMS, *_POSES}:
        raise SourceError(
            f"{topic}: messages of {', '.join(sorted(kinds))}; poses are in {', '.join((_TRANSFORMS[0], *_POSES))}"
        )
    moving: list[Stamped] = []
    fixed: list[Stamped] = []
    for message in messages:
        channel = wanted.get(message.channel)
        if channel is not None:
            (fixed if channel.topic == STATIC else moving).extend(_stamped(message, channel))
    if kinds <= set(_TRANSFORMS):
        return _by_transforms(topic, moving, fixed, frame, times, names)
    if not moving:
        raise SourceError(f"{topic}: no pose in it")
    poses = _trajectory(topic, moving).at(times, names)
    own = moving[0].child
    lever = _fixed_way(fixed, own, frame) if own != frame else np.eye(4)
    if lever is None:
        warnings.warn(
            f"{topic}: nothing static leads from {own or 'its frame, which it does not name,'} to {frame}, the frame of the scans; "
            "its poses are taken for the sensor's",
            LogWarning,
            stacklevel=2,
        )
        return poses
    return np.asarray(poses @ lever)


def _by_transforms(
    topic: str, moving: list[Stamped], fixed: list[Stamped], frame: str, times: list[int], names: list[str]
) -> F64:
    by_edge: dict[Edge, list[Stamped]] = {}
    for stamped in (*fixed, *moving):
        by_edge.setdefault((stamped.parent, stamped.child), []).append(stamped)
    parents = {child: parent for parent, child in by_edge}
    if frame not in parents:
        raise SourceError(
            f"{topic}: no transform of {frame or '(no name)'}, the frame of the scans; there are those of {', '.join(sorted(parents)) or 'none'}"
        )
    still = {(stamped.parent, stamped.child) for stamped in fixed}
    out, child, seen, moves = np.tile(np.eye(4), (len(times), 1, 1)), frame, {frame}, False
    while child in parents:
        edge = (parents[child], child)
        if edge in still:
            step: F64 = _pose(by_edge[edge][-1])
        else:
            step, moves = _trajectory(f"{topic} {edge[0]} to {child}", by_edge[edge]).at(times, names), True
        out = step @ out
        child = edge[0]
        if child in seen:
            raise SourceError(f"{topic}: transforms go round in a circle at {child}")
        seen.add(child)
    if not moves:
        raise SourceError(
            f"{topic}: all transforms from {child} to {frame} are static, nothing tells how it moved"
        )
    return out


def _fixed_way(fixed: list[Stamped], start: str, end: str) -> F64 | None:
    """Return the static pose of ``end`` in ``start``, the one being below the other; None where neither is."""
    of = {stamped.child: stamped for stamped in fixed}
    for low, high in ((end, start), (start, end)):
        pose, at, steps = np.eye(4), low, 0
        while at != high and at in of and steps <= len(of):
            pose, at, steps = _pose(of[at]) @ pose, of[at].parent, steps + 1
        if at == high:
            return pose if high == start else inverse(pose)
    return None


def _trajectory(name: str, stamped: list[Stamped]) -> Trajectory:
    return Trajectory.of(
        name,
        [one.time for one in stamped],
        np.array([one.place for one in stamped]),
        np.array([one.quaternion for one in stamped]),
    )


def _pose(stamped: Stamped) -> F64:
    return _trajectory(f"{STATIC} {stamped.parent} to {stamped.child}", [stamped]).poses[0]


def _type(channel: LogChannel) -> str:
    """The type of a channel as ROS 2 writes it."""
    package, _, name = channel.type.rpartition("/")
    return channel.type if "/msg" in package else f"{package}/msg/{name}"


def _stamped(message: LogMessage, channel: LogChannel) -> list[Stamped]:
    kind = _type(channel)
    of_ros1 = channel.encoding == "ros1"
    store = _types(of_ros1)
    read: Any = store.deserialize_ros1 if of_ros1 else store.deserialize_cdr
    try:
        told = read(message.data, _TRANSFORMS[0] if kind in _TRANSFORMS else kind)
    except Exception as error:
        raise SourceError(f"{channel.topic}: a message at {message.log_time} ns is no {kind}") from error
    if kind in _TRANSFORMS:
        return [
            _one(t.header, t.child_frame_id, t.transform.translation, t.transform.rotation)
            for t in told.transforms
        ]
    pose = told.pose if kind == _POSES[1] else told.pose.pose
    return [_one(told.header, getattr(told, "child_frame_id", ""), pose.position, pose.orientation)]


@cache
def _types(of_ros1: bool) -> Any:
    """The messages of either ROS; that of transforms is of no core package of ROS 1."""
    store = get_typestore(Stores.ROS1_NOETIC if of_ros1 else Stores.LATEST)
    if _TRANSFORMS[0] not in store.types:
        store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", _TRANSFORMS[0]))
    return store


def _one(header: Any, child: str, place: Any, turn: Any) -> Stamped:
    return Stamped(
        header.frame_id.strip("/"),
        child.strip("/"),
        header.stamp.sec * 10**9 + header.stamp.nanosec,
        (place.x, place.y, place.z),
        (turn.x, turn.y, turn.z, turn.w),
    )
