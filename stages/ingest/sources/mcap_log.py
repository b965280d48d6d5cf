"""MCAP files as logs: every channel, whatever its encoding, with all four facts of a message.

Read here and not by a ROS library, so that publish times, sequence numbers and channels of no ROS type
come through. Works on files without an index or without chunks, too; what rosbag2 compressed comes back plain.
"""

from __future__ import annotations

import os
import struct
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path

from mcap.opcode import Opcode
from mcap.records import Channel, Header, Message, Schema, Statistics

from salpcc.schemas.errors import SourceError
from salpcc.schemas.file_kind import kind_of
from salpcc.schemas.files import reading, why
from salpcc.schemas.log import Enclosed, LogChannel, LogMessage, known_as
from salpcc.schemas.marks import mark
from salpcc.schemas.mcap_chunks import (
    HEAD,
    MAX_RECORD,
    PARSE_ERRORS,
    open_chunk,
    read_chunk,
    read_enclosed,
    records,
    stream,
    top_records,
)
from salpcc.stages.ingest.sources.unpack import PlainFiles, plain_message

_MAGIC = b"\x89MCAP0\r\n"
_FOOTER = struct.Struct("<BQQQI")
_ENCLOSED = (Opcode.ATTACHMENT, Opcode.METADATA)
_OF_DATA = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE, Opcode.CHUNK)
_KNOWN = frozenset(Opcode)
_PROFILES = ("", "ros1", "ros2")


class McapLog:
    """One or more MCAP files, one after the other; channels of several files that tell the same are one.

    ``at`` of a message: the number of its file, the byte at which its record or its chunk starts, and the byte of the
    decompressed chunk, -1 where there is none.
    """

    def __init__(self, files: list[Path]) -> None:
        """Read the channels.

        Raises:
            SourceError: a file is unreadable, truncated, damaged or no MCAP file.
        """
        self.files = files
        self._plain = PlainFiles(files)
        self.channels: dict[int, LogChannel] = {}
        self._foreign: list[Counter[int]] = [
            Counter() for _ in files
        ]  # records of no kind of MCAP's, by opcode
        self._ids: list[dict[int, int]] = [{} for _ in files]  # of ours, by the file's own
        self._schemas: list[dict[int, Schema]] = [{} for _ in files]
        self._complete = False
        _chunk.cache_clear()  # whoever opens a log looks at it anew
        for number in range(len(files)):
            if not self._read_summary(number):
                for _ in self._walk(number, set()):
                    pass
        self._complete = True

    def messages(self, channels: set[int] | None = None) -> Iterator[LogMessage]:
        """Yield the messages of some channels (None: all) in the order of the files."""
        for number in range(len(self.files)):
            yield from self._walk(number, set(self.channels) if channels is None else channels)

    def _read_summary(self, number: int) -> bool:
        """Read the channels from the end of a file, if it tells all of them there."""
        try:
            with reading(self._plain.paths[number]) as file:
                end = file.seek(0, os.SEEK_END) - _FOOTER.size - len(_MAGIC)
                file.seek(max(end, 0))
                opcode, length, start, *_ = _FOOTER.unpack(file.read(_FOOTER.size))
                if (opcode, length) != (Opcode.FOOTER, 20) or not 0 < start <= end <= start + MAX_RECORD:
                    return False
                file.seek(start)
                found = list(records(file.read(end - start)))
            told = [Statistics.read(stream(data)) for op, _, data in found if op == Opcode.STATISTICS]
            channels = [Channel.read(stream(data)) for op, _, data in found if op == Opcode.CHANNEL]
            if not told or told[0].channel_count != len(channels):
                return False
            for schema in (Schema.read(stream(data)) for op, _, data in found if op == Opcode.SCHEMA):
                self._schemas[number][schema.id] = schema
            for channel in channels:
                self._add(number, channel)
            return True
        except (OSError, *PARSE_ERRORS):
            return False  # the walk will say what is wrong

    def message(self, topic: str, time: int, at: tuple[int, ...]) -> LogMessage:
        """Read the message at a place that :meth:`messages` told."""
        number, start, within = at
        path = self._plain.paths[number]
        try:
            with reading(path) as file:
                file.seek(start - HEAD.size)
                _, length = HEAD.unpack(file.read(HEAD.size))
                if within < 0:
                    content = file.read(min(length, MAX_RECORD))
                else:
                    data = _chunk(path, mark(path), start, length)
                    _, inner = HEAD.unpack_from(data, within)
                    content = data[within + HEAD.size : within + HEAD.size + inner]
            return self._message(number, content, at)
        except OSError as error:
            raise SourceError(f"{self.files[number]}: {why(error)}") from error
        except PARSE_ERRORS as error:
            raise SourceError(
                f"{self.files[number]}: {topic} at {time}: damaged ({error}); `mcap recover` saves what is whole"
            ) from error

    def enclosed(self) -> Iterator[Enclosed]:
        """Yield attachments and metadata in the order of the files."""
        for number in range(len(self.files)):
            for opcode, _, content in self._top(number, _ENCLOSED):
                with self._failing(number):
                    yield read_enclosed(opcode, content)

    def left_behind(self) -> list[str]:
        """Name records of no kind of MCAP's, schemas that no channel uses, and the profile where it is nobody's."""
        foreign = sum(self._foreign, Counter[int]())
        found = [f"{n} records of the private kind {kind:#x}" for kind, n in sorted(foreign.items())]
        used = {(c.type, c.schema_encoding, c.schema) for c in self.channels.values()}
        for schemas in self._schemas:
            spare = [s for s in schemas.values() if (s.name, s.encoding, bytes(s.data)) not in used]
            found += [f"the schema {schema.name}, which no channel uses" for schema in spare]
        for number, path in enumerate(self._plain.paths):
            with self._failing(number), reading(path) as file:
                opcode, at, length = next(top_records(file, path.stat().st_size, len(_MAGIC)))
                file.seek(at)
                head = (
                    Header.read(stream(file.read(min(length, MAX_RECORD))))
                    if opcode == Opcode.HEADER
                    else None
                )
                if head and head.profile not in _PROFILES:
                    found.append(f"the profile {head.profile}")
        return list(dict.fromkeys(found))

    def _walk(self, number: int, wanted: set[int]) -> Iterator[LogMessage]:
        """Go through a file and yield its messages of the channels wanted."""
        for opcode, at, content in self._top(number, _OF_DATA):
            with self._failing(number):
                if opcode != Opcode.CHUNK:
                    yield from self._record(number, opcode, content, (number, at, -1), wanted)
                    continue
                for inner, within, record in records(open_chunk(content, at)):
                    yield from self._record(number, inner, record, (number, at, within), wanted)

    def _top(self, number: int, wanted: tuple[Opcode, ...]) -> Iterator[tuple[int, int, bytes]]:
        """Yield opcode, place and content of the records of some kinds that stand outside of chunks."""
        path = self._plain.paths[number]
        with self._failing(number), reading(path) as file:
            if file.read(len(_MAGIC)) != _MAGIC:
                raise SourceError(f"{self.files[number]}: {kind_of(path)}, not an MCAP file")
            ended = False
            foreign: Counter[int] = Counter()
            for opcode, at, length in top_records(file, path.stat().st_size, len(_MAGIC)):
                ended = ended or opcode == Opcode.DATA_END
                foreign[opcode] += opcode not in _KNOWN
                if ended or opcode not in wanted:
                    continue
                if length > MAX_RECORD:
                    raise SourceError(
                        f"{self.files[number]}: the record at byte {at} has {length} bytes, more than {MAX_RECORD} are not read"
                    )
                file.seek(at)
                yield opcode, at, file.read(length)
            self._foreign[number] = +foreign
            if not ended:
                raise ValueError("ends early: no end of its data")

    @contextmanager
    def _failing(self, number: int) -> Iterator[None]:
        """Turn what a file raises into one error that names it."""
        try:
            yield
        except OSError as error:
            raise SourceError(f"{self.files[number]}: {why(error)}") from error
        except PARSE_ERRORS as error:
            raise SourceError(f"{self.files[number]}: {error}; `mcap recover` saves what is whole") from error

    def _record(
        self, number: int, opcode: int, content: bytes, at: tuple[int, ...], wanted: set[int]
    ) -> Iterator[LogMessage]:
        if opcode == Opcode.MESSAGE:
            channel = self._ids[number].get(int.from_bytes(content[:2], "little"))
            if channel is None:
                raise ValueError("a message is of a channel that is not told before")
            if channel in wanted:
                yield self._message(number, content, at)
        elif opcode == Opcode.SCHEMA:
            schema = Schema.read(stream(content))
            self._schemas[number][schema.id] = schema
        elif opcode == Opcode.CHANNEL:
            self._add(number, Channel.read(stream(content)))

    def _add(self, number: int, channel: Channel) -> None:
        schema = Schema(0, b"", "", "")
        if channel.schema_id:
            schema = self._schemas[number][channel.schema_id]
        facts = (
            channel.topic, channel.message_encoding, schema.name, schema.encoding, bytes(schema.data),
            tuple(sorted(channel.metadata.items())),
        )  # fmt: skip
        ids = self._ids[number]
        if channel.id in ids:
            known = self.channels[ids[channel.id]]
            if known != LogChannel(known.id, *facts):
                raise ValueError(f"it tells of the channel {channel.id} ({known.topic}) in two ways")
            return
        if self._complete:
            raise ValueError(
                f"its summary does not tell of the channel {channel.topic}; `mcap recover` mends it"
            )
        ids[channel.id] = known_as(LogChannel(0, *facts), self.channels, ids.values()).id

    def _message(self, number: int, content: bytes, at: tuple[int, ...]) -> LogMessage:
        message = Message.read(stream(content), len(content))
        channel = self.channels[self._ids[number][message.channel_id]]
        data = plain_message(bytes(message.data), channel.encoding)
        return LogMessage(channel.id, message.log_time, message.publish_time, message.sequence, data, at)


@lru_cache(maxsize=2)
def _chunk(path: Path, changed: str, at: int, length: int) -> bytes:
    """The records of a chunk; the messages of a topic often share one."""
    with reading(path) as file:
        return read_chunk(file, at, length)
