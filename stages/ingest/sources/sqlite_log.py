"""ROS 2 bags in SQLite as logs: every row of every file, by the tables alone.

Read here and not by a ROS library, so that nothing but the files decides what is in them: rows that a killed
recorder left in a write-ahead log are there, topics that ``metadata.yaml`` tells otherwise or not at all, and
files whose times overlap.
"""

from __future__ import annotations

import heapq
import shutil
import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from operator import attrgetter
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from rosbags.rosbag2.metadata import dump_qos_v8, parse_qos
from rosbags.typesys import Stores, get_typestore

from salpcc.schemas.errors import SourceError
from salpcc.schemas.file_kind import kind_of
from salpcc.schemas.files import why
from salpcc.schemas.log import Enclosed, LogChannel, LogMessage, known_as
from salpcc.schemas.mcap_chunks import MAX_RECORD
from salpcc.stages.ingest.sources.unpack import PlainFiles, plain_message

_TABLES = {"messages", "topics"}
_OTHER_TABLES = {"schema", "metadata", "message_definitions", "sqlite_sequence"}  # of rosbag2's, no messages
_COLUMNS = {
    "messages": {"id", "topic_id", "timestamp", "data"},
    "topics": {"id", "name", "type", "serialization_format", "offered_qos_profiles", "type_description_hash"},
}
_BESIDE = ("-wal", "-journal")  # what SQLite has not put into the file yet
OF_SQLITE = (*_BESIDE, "-shm")  # ends of the names of files beside one of SQLite's


class SqliteLog:
    """The files of a ROS 2 bag in SQLite. ``at`` of a message: the number of its file, its row in the table."""

    def __init__(self, files: list[Path]) -> None:
        """Open the files and read their topics.

        Raises:
            SourceError: a file is unreadable, damaged, or no ROS 2 bag.
        """
        self.files = files
        self.channels: dict[int, LogChannel] = {}
        self._plain = PlainFiles(files)
        self._folder: TemporaryDirectory[str] | None = None
        self._ids: list[dict[int, int]] = [{} for _ in files]  # of channels, by a file's own topic ids
        self._open: list[sqlite3.Connection] = []
        for number in range(len(files)):
            with self._failing(number):
                self._open.append(self._connect(number))
                self._read_topics(number)

    def messages(self, channels: set[int] | None = None) -> Iterator[LogMessage]:
        """Yield the messages of some channels (None: all) by time."""
        rows = (self._rows(number, channels) for number in range(len(self.files)))
        return heapq.merge(*rows, key=attrgetter("log_time"))

    def message(self, topic: str, time: int, at: tuple[int, ...]) -> LogMessage:
        """Read the message at a place that :meth:`messages` told."""
        number, row = at
        with self._failing(number):
            found = self._open[number].execute(_ROWS + "WHERE rowid = ?", (row,)).fetchone()
            if found is None:
                raise ValueError(f"{topic} at {time}: row {row} is not there any more")
            return self._message(number, *found)

    def enclosed(self) -> Iterator[Enclosed]:
        """Yield nothing: these bags have no attachments."""
        return iter(())

    def left_behind(self) -> list[str]:
        """Name tables and columns that are none of those known."""
        found: set[str] = set()
        for number, file in enumerate(self._open):
            with self._failing(number):
                found |= {f"the table {name}" for name in _tables(file) - _TABLES - _OTHER_TABLES}
                for table, known in _COLUMNS.items():
                    found |= {f"the column {name} of {table}" for name in _columns(file, table) - known}
        return sorted(found)

    def _connect(self, number: int) -> sqlite3.Connection:
        """Open a file for reading; where not all of it is in it yet, a copy to which SQLite may add the rest."""
        path = self._plain.paths[number]
        waiting = [file for file in beside(path) if file.stat().st_size]
        how = "mode=ro&immutable=1"  # leaves no file beside it
        if waiting:
            self._folder = self._folder or TemporaryDirectory(prefix="salpcc-")
            copy = Path(self._folder.name) / f"{number}.db3"
            shutil.copyfile(path, copy)
            for file in waiting:
                shutil.copyfile(file, copy.with_name(copy.name + file.name.removeprefix(path.name)))
            path, how = copy, "mode=rw"
        uri = f"{path.absolute().as_uri()}?{how}"  # quotes what a URI would take for its own
        file_ = sqlite3.connect(uri, uri=True, check_same_thread=False)
        file_.execute("PRAGMA trusted_schema = OFF")
        return file_

    def _read_topics(self, number: int) -> None:
        file = self._open[number]
        if missing := _TABLES - _tables(file):
            raise ValueError(f"no ROS 2 bag: it has no table {min(missing)}")
        columns = _columns(file, "topics")
        more = [
            name if name in columns else "''" for name in ("offered_qos_profiles", "type_description_hash")
        ]
        told = {}
        if "message_definitions" in _tables(file):
            query = (
                "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions ORDER BY id"
            )
            told = {kind: (encoding, text) for kind, encoding, text in reversed(list(file.execute(query)))}
        rows = file.execute(
            f"SELECT id, name, type, serialization_format, {', '.join(more)} FROM topics ORDER BY id"
        )
        for id_, topic, kind, encoding, profiles, type_hash in rows:
            if not isinstance(id_, int) or not all(
                isinstance(t, str) for t in (topic, kind, encoding, profiles, type_hash)
            ):
                raise ValueError(f"a topic with the number {id_} has no name or type")
            schema_encoding, text = told.get(kind, ("", ""))
            if not text:
                schema_encoding, text = "ros2msg", _known_definition(kind)
            metadata = [("offered_qos_profiles", qos_text(profiles))]
            metadata += (
                [("topic_type_hash", type_hash)] if type_hash else []
            )  # the names that rosbag2 gives them
            new = LogChannel(0, topic, encoding, kind, schema_encoding, text.encode(), tuple(metadata))
            ids = self._ids[number]
            ids[id_] = known_as(new, self.channels, ids.values()).id

    def _rows(self, number: int, channels: set[int] | None) -> Iterator[LogMessage]:
        with self._failing(number):
            wanted = [
                id_ for id_, known in self._ids[number].items() if channels is None or known in channels
            ]
            which = "" if channels is None else f"WHERE topic_id IN ({','.join(map(str, wanted))}) "
            for row in self._open[number].execute(f"{_ROWS}{which}ORDER BY timestamp, rowid"):
                yield self._message(number, *row)

    def _message(self, number: int, row: int, topic: int, time: int, data: bytes) -> LogMessage:
        if topic not in self._ids[number]:
            raise ValueError(f"row {row} is of a topic that it does not tell of")
        if not isinstance(time, int) or time < 0 or not isinstance(data, bytes) or len(data) > MAX_RECORD:
            raise ValueError(f"row {row} has a time before 1970, or data that are no message")
        channel = self.channels[self._ids[number][topic]]
        plain = plain_message(data, channel.encoding)
        return LogMessage(channel.id, time, time, 0, plain, (number, row))

    @contextmanager
    def _failing(self, number: int) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise SourceError(f"{self.files[number]}: {why(error)}") from error
        except (GeneratorExit, SourceError):
            raise
        except Exception as error:  # hostile bytes make of SQLite, YAML and UTF-8 what they like
            kind = kind_of(self._plain.paths[number])
            said = (
                f"{kind}, not an SQLite file"
                if kind != "an SQLite file"
                else f"cannot be read as a ROS 2 bag ({error}); `sqlite3 FILE .recover` saves what is whole"
            )
            raise SourceError(f"{self.files[number]}: {said}") from error


_ROWS = "SELECT rowid, topic_id, timestamp, data FROM messages "


def beside(path: Path) -> list[Path]:
    """Return the files beside one of SQLite's that belong to it."""
    return [file for end in _BESIDE if (file := path.with_name(path.name + end)).is_file()]


def _tables(file: sqlite3.Connection) -> set[str]:
    return {name for (name,) in file.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}


def _columns(file: sqlite3.Connection, table: str) -> set[str]:
    return {row[1] for row in file.execute(f"PRAGMA table_info({table})")}


def qos_text(profiles: Any) -> str:
    """Return QoS profiles in the words that every distribution reads; as they are where nobody reads them."""
    try:
        return str(dump_qos_v8(parse_qos(profiles)))
    except Exception:  # noqa: BLE001 (anybody's text)
        return str(profiles)


@cache
def _known_definition(kind: str) -> str:
    """The definition that ROS ships of a type; nothing where it is somebody's own."""
    try:
        return str(get_typestore(Stores.ROS2_HUMBLE).generate_msgdef(kind, ros_version=2)[0])
    except Exception:  # noqa: BLE001 (whatever it is, the messages pass without it)
        return ""
