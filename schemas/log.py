"""A recorded log: channels of messages, as MCAP has them; bags of ROS 1 and 2 are told in the same words."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace
from typing import Protocol

CLOUD_TYPES = ("sensor_msgs/msg/PointCloud2", "sensor_msgs/PointCloud2")


@dataclass(frozen=True)
class LogChannel:
    """What is the same for all messages of a channel; the fields are those of MCAP's Channel and Schema."""

    id: int
    topic: str
    encoding: str
    type: str
    schema_encoding: str
    schema: bytes
    metadata: tuple[tuple[str, str], ...] = ()

    @property
    def holds_clouds(self) -> bool:
        """Tell whether its messages are point clouds that we read."""
        return self.type in CLOUD_TYPES and self.encoding in ("cdr", "ros1")


def known_as(new: LogChannel, channels: dict[int, LogChannel], taken: Collection[int]) -> LogChannel:
    """Find the channel of a log that tells the same as that of one of its files, or add it under the next id.

    Args:
        taken: ids of that file's other channels. Two of one file that tell the same stay two.
    """
    for known in channels.values():
        if known.id not in taken and replace(new, id=known.id) == known:
            return known
    return channels.setdefault(len(channels) + 1, replace(new, id=len(channels) + 1))


@dataclass(frozen=True)
class LogMessage:
    """A message as it is recorded; times in nanoseconds, ``at`` the place by which its log finds it again.

    No other message of the log has the same place: it is of the file and of the record, row or byte in it.
    """

    channel: int
    log_time: int
    publish_time: int
    sequence: int
    data: bytes
    at: tuple[int, ...] = ()


@dataclass(frozen=True)
class LogAttachment:
    """A file that somebody put into a log; times in nanoseconds."""

    log_time: int
    create_time: int
    name: str
    media_type: str
    data: bytes


@dataclass(frozen=True)
class LogMetadata:
    """Facts that somebody put into a log, under a name that need not be the only one of its kind."""

    name: str
    facts: tuple[tuple[str, str], ...]


Enclosed = LogAttachment | LogMetadata


class Log(Protocol):
    """A log that can be read more than once; every failure is a SourceError that names the file."""

    channels: dict[int, LogChannel]

    def messages(self, channels: set[int] | None = None) -> Iterator[LogMessage]:
        """Yield the messages of some channels (None: all) in the order of the file."""
        ...

    def message(self, topic: str, time: int, at: tuple[int, ...]) -> LogMessage:
        """Read the message of a topic at a place that :meth:`messages` told."""
        ...

    def enclosed(self) -> Iterator[Enclosed]:
        """Yield what the log holds besides messages, in the order of the file."""
        ...

    def left_behind(self) -> list[str]:
        """Say what of it is none of these and stays behind; all messages have been gone through before."""
        ...
