"""ROS 1 bags, and ROS 2 bags in SQLite, as logs (through rosbags). ROS 2 bags in MCAP are MCAP files."""

from __future__ import annotations

import bz2
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import lz4.frame
from rosbags.interfaces import Connection, ConnectionExtRosbag1, MessageDefinitionFormat
from rosbags.rosbag1 import Reader as Rosbag1
from rosbags.rosbag2 import Reader as Rosbag2
from rosbags.rosbag2.metadata import dump_qos_v8
from rosbags.typesys import Stores, get_typestore

from salpcc.schemas.errors import SourceError
from salpcc.schemas.log import Enclosed, LogChannel, LogMessage
from salpcc.schemas.mcap_chunks import MAX_RECORD

_SCHEMA_ENCODINGS = {
    MessageDefinitionFormat.NONE: "",
    MessageDefinitionFormat.MSG: "ros2msg",
    MessageDefinitionFormat.IDL: "ros2idl",
}


class RosLog:
    """A ROS bag. ``at`` of a message counts the ones of its topic at the same time before it."""

    def __init__(self, path: Path) -> None:
        """Open the bag and read its connections.

        Raises:
            SourceError: unreadable, not indexed, damaged, or no bag.
        """
        self.path = path
        with self._failing():
            # Not AnyReader: it parses the definitions of all types, and we need none.
            self._reader: Rosbag1 | Rosbag2 = (Rosbag1 if path.suffix == ".bag" else Rosbag2)(path)
            self._reader.open()
            if isinstance(self._reader, Rosbag1):
                self._reader.chunks = {
                    at: chunk._replace(decompressor=_bounded(chunk.decompressor))
                    for at, chunk in self._reader.chunks.items()
                }
            self._connections = {n: c for n, c in enumerate(self._reader.connections, 1)}
            self.channels = {n: self._channel(n, c) for n, c in self._connections.items()}

    def messages(self, channels: set[int] | None = None) -> Iterator[LogMessage]:
        """Yield the messages of some channels (None: all) by time."""
        wanted = [c for n, c in self._connections.items() if channels is None or n in channels]
        before: dict[str, tuple[int, int]] = {}
        for number, topic, time, data in self._read(wanted):
            last, count = before.get(topic, (-1, 0))
            place = count if time == last else 0
            before[topic] = time, place + 1
            yield LogMessage(number, time, time, 0, data, (place,))

    def message(self, topic: str, time: int, at: tuple[int, ...]) -> LogMessage:
        """Read the message of a topic at a time and a place that :meth:`messages` told."""
        wanted = [c for c in self._connections.values() if c.topic == topic]
        for place, (number, _, found, data) in enumerate(self._read(wanted, time, time + 1)):
            if (place,) == at:
                return LogMessage(number, found, found, 0, data, at)
        raise SourceError(f"{self.path}: {topic} has no message at {time} any more")

    def enclosed(self) -> Iterator[Enclosed]:
        """Yield nothing: bags have no attachments."""
        return iter(())

    def _read(self, connections: list[Connection], *window: int) -> Iterator[tuple[int, str, int, bytes]]:
        if not connections:
            return  # to the reader, none is all
        numbers = {c.id: n for n, c in self._connections.items()}
        with self._failing():
            for connection, time, data in self._reader.messages(connections, *window):
                yield numbers[connection.id], connection.topic, time, bytes(data)

    def _channel(self, number: int, connection: Connection) -> LogChannel:
        ext, definition = connection.ext, connection.msgdef
        if isinstance(ext, ConnectionExtRosbag1):
            facts = {"md5sum": connection.digest, "callerid": ext.callerid, "latching": ext.latching}
            metadata = tuple(sorted((k, str(v)) for k, v in facts.items() if v is not None))
            name = connection.msgtype.replace("/msg/", "/")
            return LogChannel(
                number, connection.topic, "ros1", name, "ros1msg", definition.data.encode(), metadata
            )
        encoding, text = _SCHEMA_ENCODINGS[definition.format], definition.data
        if not text:
            encoding, text = "ros2msg", self._known_definition(connection.msgtype)
        metadata = (("offered_qos_profiles", dump_qos_v8(ext.offered_qos_profiles)),)
        return LogChannel(
            number,
            connection.topic,
            ext.serialization_format,
            connection.msgtype,
            encoding,
            text.encode(),
            metadata,
        )

    def _known_definition(self, kind: str) -> str:
        """The definition that ROS ships of a type; nothing where it is somebody's own."""
        try:
            return str(get_typestore(Stores.ROS2_HUMBLE).generate_msgdef(kind, ros_version=2)[0])
        except Exception:  # noqa: BLE001 (whatever it is, the messages pass without it)
            return ""

    @contextmanager
    def _failing(self) -> Iterator[None]:
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                yield
        except (GeneratorExit, SourceError):
            raise
        except Exception as error:  # the reader meets hostile bytes with whatever comes to hand
            raise SourceError(
                f"{self.path}: cannot be read as a ROS bag ({error or type(error).__name__})"
            ) from error


def _bounded(decompressor: Callable[[bytes], bytes]) -> Callable[[bytes], bytes]:
    """The same decompressor, but one that gives up at MAX_RECORD."""
    streams: dict[Any, Callable[[], Any]] = {
        bz2.decompress: bz2.BZ2Decompressor,
        lz4.frame.decompress: lz4.frame.LZ4FrameDecompressor,
    }
    make = streams.get(decompressor)
    return decompressor if make is None else partial(_decompress, make)


def _decompress(make: Callable[[], Any], data: bytes) -> bytes:
    stream = make()
    plain: bytes = stream.decompress(data, MAX_RECORD)
    if not stream.eof:
        raise ValueError(f"a chunk gives more than {MAX_RECORD} bytes, or ends early")
    return plain
