"""How many messages a log holds, counted by other means than its reader reads it.

A reader that passes something over says nothing; its messages are gone, and so they are from a comparison that reads
by the same reader. So nothing here is shared with the readers: an MCAP file is counted by its own statistics (where
it has none, by the ``mcap`` package's pass over its records), a ROS 1 bag by the counts of its index, a file of SQLite
by SQL.
"""

from __future__ import annotations

import shutil
import sqlite3
import struct
from collections import Counter
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import BinaryIO

import zstandard
from mcap.reader import SeekingReader
from mcap.records import Channel, Message
from mcap.stream_reader import StreamReader

from salpcc.schemas.errors import SourceError
from salpcc.schemas.files import reading, why

Counts = Counter[str]  # messages by topic
_ZSTD = b"\x28\xb5\x2f\xfd"
_CONNECTION, _CHUNK_INFO = b"\x07", b"\x06"


def count_messages(storage: str, files: list[Path]) -> Counts:
    """Count the messages of the files of a log, by topic; ``storage`` is a key of COUNTERS.

    Raises:
        SourceError: one of them cannot be counted.
    """
    total: Counts = Counter()
    count = COUNTERS[storage]
    for file in files:
        try:
            with reading(file) as stream:
                packed = stream.read(4) == _ZSTD
            total += _unpacked(file, count) if packed else count(file)
        except OSError as error:
            raise SourceError(f"{file}: {why(error)}") from error
        except Exception as error:  # what the packages make of a damaged file
            raise SourceError(
                f"{file}: its messages cannot be counted ({error or type(error).__name__})"
            ) from error
    return total


def _unpacked(file: Path, count: Callable[[Path], Counts]) -> Counts:
    with TemporaryDirectory(prefix="salpcc-") as folder, reading(file) as source:
        plain = Path(folder) / "plain"
        with open(plain, "wb") as out:
            zstandard.ZstdDecompressor().copy_stream(source, out)
        return count(plain)


def _mcap(file: Path) -> Counts:
    with reading(file) as stream:
        summary = SeekingReader(stream).get_summary()
        if summary is not None and summary.statistics is not None:
            told, by_id = summary.statistics, summary.statistics.channel_message_counts
            if set(by_id) <= set(summary.channels) and sum(by_id.values()) == told.message_count:
                counts: Counts = Counter()
                for channel, number in by_id.items():
                    counts[summary.channels[channel].topic] += number
                return +counts
        return _records(stream)


def _records(stream: BinaryIO) -> Counts:
    stream.seek(0)
    topics: dict[int, str] = {}
    counts: Counts = Counter()
    for record in StreamReader(stream).records:
        if isinstance(record, Channel):
            topics[record.id] = record.topic
        elif isinstance(record, Message):
            counts[topics[record.channel_id]] += 1
    return counts


def _sqlite(file: Path) -> Counts:
    with TemporaryDirectory(prefix="salpcc-") as folder:
        uri = f"{file.absolute().as_uri()}?immutable=1"
        # What lies beside the file under its name and a hyphen may hold a part of it; SQLite puts a copy together.
        parts = [part for part in file.parent.iterdir() if part.name.startswith(f"{file.name}-")]
        if any(part.stat().st_size for part in parts):
            parts.append(file)
            for part in parts:
                shutil.copyfile(part, Path(folder) / part.name.replace(file.name, "whole", 1))
            uri = (Path(folder) / "whole").as_uri()
        with closing(sqlite3.connect(uri, uri=True)) as database:
            rows = database.execute(
                "SELECT name, COUNT(*) FROM messages LEFT JOIN topics ON topic_id = topics.id GROUP BY topics.id"
            )
            counts: Counts = Counter()
            for topic, number in rows:
                counts[str(topic)] += number
            return counts


def _bag(file: Path) -> Counts:
    """Sum the counts that the index of a ROS 1 bag gives of each chunk; the records of the chunks are not read."""
    with reading(file) as stream:
        stream.readline()
        head = _header(stream)
        if not int.from_bytes(head[b"chunk_count"], "little"):
            return Counter()
        stream.seek(int.from_bytes(head[b"index_pos"], "little"))
        topics: dict[int, str] = {}
        by_id: Counter[int] = Counter()
        while size := stream.read(4):
            record = _fields(stream.read(*struct.unpack("<I", size)))
            data = stream.read(*struct.unpack("<I", stream.read(4)))
            if record[b"op"] == _CONNECTION:
                topics[int.from_bytes(record[b"conn"], "little")] = record[b"topic"].decode()
            elif record[b"op"] == _CHUNK_INFO:
                for connection, number in struct.iter_unpack("<II", data):
                    by_id[connection] += number
    counts: Counts = Counter()
    for connection, number in by_id.items():
        counts[_tidy(topics[connection])] += number
    return +counts


def _header(stream: BinaryIO) -> dict[bytes, bytes]:
    return _fields(stream.read(*struct.unpack("<I", stream.read(4))))


def _fields(data: bytes) -> dict[bytes, bytes]:
    found, at = {}, 0
    while at < len(data):
        (length,) = struct.unpack_from("<I", data, at)
        name, _, value = data[at + 4 : at + 4 + length].partition(b"=")
        found[name] = value
        at += 4 + length
    return found


def _tidy(topic: str) -> str:
    """A topic without doubled and closing slashes, as readers name it."""
    return "/" * topic.startswith("/") + "/".join(part for part in topic.split("/") if part)


COUNTERS: dict[str, Callable[[Path], Counts]] = {"mcap": _mcap, "sqlite3": _sqlite, "ros1": _bag}
