"""ROS 1 bags as logs: the index through rosbags, each message by its place in it."""

from __future__ import annotations

import bz2
import heapq
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from io import BytesIO
from operator import itemgetter
from pathlib import Path
from typing import Any

import lz4.frame
from rosbags.interfaces import Connection, ConnectionExtRosbag1
from rosbags.rosbag1 import Reader
from rosbags.rosbag1.reader import Header, RecordType, read_bytes, read_uint32

from salpcc.schemas.errors import SourceError
from salpcc.schemas.file_kind import kind_of
from salpcc.schemas.log import Enclosed, LogChannel, LogMessage
from salpcc.schemas.mcap_chunks import MAX_RECORD

_KEPT = {"topic", "type", "md5sum", "message_definition", "callerid", "latching"}
_CHUNKS = 4  # decompressed at a time: chunks overlap where publishers are recorded side by side


class Ros1Log:
    """A ROS 1 bag; every connection is a channel. ``at`` of a message: the byte of its chunk, its byte in that."""

    def __init__(self, path: Path) -> None:
        """Open the bag and read its index.

        Raises:
            SourceError: unreadable, not indexed, damaged, or no bag.
        """
        self.path = path
        self._chunks: dict[int, bytes] = {}
        with self._failing():
            self._reader = Reader(path)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                self._reader.open()
            self._connections = {n: c for n, c in enumerate(self._reader.connections, 1)}
            self._numbers = {c.id: n for n, c in self._connections.items()}
            self.channels = {n: _channel(n, c) for n, c in self._connections.items()}

    def messages(self, channels: set[int] | None = None) -> Iterator[LogMessage]:
        """Yield the messages of some channels (None: all) by time."""
        with self._failing():
            places = (
                [(entry.time, entry.chunk_pos, entry.offset) for entry in self._reader.indexes[c.id]]
                for n, c in self._connections.items()
                if channels is None or n in channels
            )
            for time, *at in heapq.merge(*places, key=itemgetter(0)):
                yield self._message(time, tuple(at))

    def message(self, topic: str, time: int, at: tuple[int, ...]) -> LogMessage:
        """Read the message at a place that :meth:`messages` told."""
        with self._failing():
            return self._message(time, at)

    def enclosed(self) -> Iterator[Enclosed]:
        """Yield nothing: bags have no attachments."""
        return iter(())

    def left_behind(self) -> list[str]:
        """Name what headers of connections hold besides the facts that a channel keeps."""
        found = []
        with self._failing():
            bio = self._reader.bio
            assert bio is not None
            bio.seek(0)
            bio.readline()
            bio.seek(Header.read(bio).get_uint64("index_pos"))
            for connection in self._connections.values():
                topic, facts = Header.read(bio).get_string("topic"), Header.read(bio)
                more = [f"{name} in a header of {topic}" for name in sorted(facts.keys() - _KEPT)]
                names = {topic, facts["topic"].decode() if "topic" in facts else topic} - {connection.topic}
                found += more + [
                    f"the name {name}, which becomes {connection.topic}" for name in sorted(names)
                ]
        return list(dict.fromkeys(found))

    def _message(self, time: int, at: tuple[int, ...]) -> LogMessage:
        chunk, offset = at
        record = BytesIO(self._chunk(chunk))
        record.seek(offset)
        header = Header.read(record)
        while (
            header.get_uint8("op") == RecordType.CONNECTION
        ):  # some writers let the index point before these
            read_bytes(record, read_uint32(record))
            header = Header.read(record)
        if header.get_uint8("op") != RecordType.MSGDATA or header.get_time("time") != time:
            raise ValueError(f"its index tells of a message at {time} that is not there")
        channel = self._numbers[header.get_uint32("conn")]
        return LogMessage(channel, time, time, 0, read_bytes(record, read_uint32(record)), at)

    def _chunk(self, at: int) -> bytes:
        if at not in self._chunks:
            bio, chunk = self._reader.bio, self._reader.chunks[at]
            assert bio is not None
            bio.seek(chunk.datapos)
            plain = _bounded(chunk.decompressor)(read_bytes(bio, chunk.datasize))
            while len(self._chunks) >= _CHUNKS:
                self._chunks.pop(next(iter(self._chunks)))
            self._chunks[at] = plain
        return self._chunks[at]

    @contextmanager
    def _failing(self) -> Iterator[None]:
        try:
            yield
        except (GeneratorExit, SourceError):
            raise
        except Exception as error:  # the reader meets hostile bytes with whatever comes to hand
            kind = kind_of(self.path)
            said = (
                f"{kind}, not a ROS 1 bag"
                if kind != "a ROS 1 bag"
                else f"cannot be read as a ROS bag ({error or type(error).__name__}); `rosbag reindex` mends one that was cut off"
            )
            raise SourceError(f"{self.path}: {said}") from error


def _channel(number: int, connection: Connection) -> LogChannel:
    ext = connection.ext
    assert isinstance(ext, ConnectionExtRosbag1)
    facts = {"md5sum": connection.digest, "callerid": ext.callerid, "latching": ext.latching}
    metadata = tuple(sorted((k, str(v)) for k, v in facts.items() if v is not None))
    name = connection.msgtype.replace("/msg/", "/")
    definition = connection.msgdef.data.encode()
    return LogChannel(number, connection.topic, "ros1", name, "ros1msg", definition, metadata)


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
