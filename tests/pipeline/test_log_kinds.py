"""Kinds of recorded logs that lose messages where one trusts their metadata, a library's filter or a time stamp."""

import sqlite3
import struct
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
import zstandard
from mcap.reader import make_reader
from mcap.records import Statistics
from mcap.writer import Writer as McapWriter
from rosbags.rosbag1 import Reader as Rosbag1Reader
from rosbags.rosbag1 import Writer as Rosbag1Writer
from rosbags.rosbag1.writer import Header
from rosbags.rosbag2 import Reader as Rosbag2Reader
from rosbags.typesys import Stores, get_typestore

from salpcc.pipeline import Archive
from salpcc.pipeline.export import EXPORTS
from salpcc.pipeline.graph.graph import GraphOptions
from salpcc.pipeline.run import RunRequest, run_sequences
from salpcc.pipeline.verify import verify
from salpcc.schemas.config import RunConfig
from salpcc.schemas.errors import LogWarning, SalpccError, SourceError
from salpcc.schemas.log import LogMessage
from salpcc.schemas.messages import PLAIN, SCHEMA_TEXT, CloudMessage
from salpcc.schemas.passing_log import PassingLog
from salpcc.stages.ingest.sources import bag
from salpcc.stages.ingest.sources.bag import Bag, count_log, find_log, open_log
from salpcc.stages.ingest.sources.mcap_log import McapLog
from salpcc.stages.ingest.sources.sqlite_log import SqliteLog

Command = Callable[..., tuple[int, str]]
STRING = "std_msgs/msg/String"
START = 1_700_000_000_000_000_000
STEP = 100_000_000
QOS = """\
- history: 3
  depth: 0
  reliability: 1
  durability: 2
  deadline: {sec: 2147483647, nsec: 4294967295}
  lifespan: {sec: 2147483647, nsec: 4294967295}
  liveliness: 1
  liveliness_lease_duration: {sec: 2147483647, nsec: 4294967295}
  avoid_ros_namespace_conventions: false"""


@dataclass(frozen=True)
class Row:
    """A message: topic, type, time in ns, bytes."""

    topic: str
    kind: str
    time: int
    data: bytes


def cloud(number: int, time: int) -> Row:
    """Forty points that no other number has, on /points."""
    points = np.random.default_rng(number).normal(0, 20, (40, 4)).astype("<f4")
    return Row("/points", PLAIN, time, CloudMessage(time, "lidar", 40, points.tobytes()).to_cdr())


def text(words: str, time: int, topic: str = "/texts") -> Row:
    length = len(words) + 1
    return Row(topic, STRING, time, b"\0\1\0\0" + struct.pack("<I", length) + words.encode() + b"\0")


def drive(first: int = 0, count: int = 3) -> list[Row]:
    """Clouds at 10 Hz, a text after each."""
    rows = []
    for n in range(first, first + count):
        rows += [cloud(n, START + n * STEP), text(f"text {n}", START + n * STEP + 5)]
    return rows


def write_db3(path: Path, rows: list[Row], qos: str = QOS, late: int = 0) -> None:
    """Write a file as rosbag2 of Humble does; the last ``late`` rows stay in its write-ahead log."""
    base = sqlite3.connect(path, isolation_level=None)
    if late:
        base.execute("PRAGMA journal_mode = WAL")
        base.execute("PRAGMA wal_autocheckpoint = 0")
    base.executescript(
        """
        CREATE TABLE schema(schema_version INTEGER PRIMARY KEY, ros_distro TEXT NOT NULL);
        INSERT INTO schema VALUES(3, 'humble');
        CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL,
            serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL);
        CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, timestamp INTEGER NOT NULL,
            data BLOB NOT NULL);
        CREATE INDEX timestamp_idx ON messages (timestamp ASC);
        """
    )
    ids: dict[tuple[str, str], int] = {}
    for place, row in enumerate(rows):
        if place == len(rows) - late:
            base.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        if (row.topic, row.kind) not in ids:
            ids[row.topic, row.kind] = len(ids) + 1
            base.execute("INSERT INTO topics VALUES(?, ?, ?, 'cdr', ?)", (len(ids), row.topic, row.kind, qos))
        base.execute(
            "INSERT INTO messages(topic_id, timestamp, data) VALUES(?, ?, ?)",
            (ids[row.topic, row.kind], row.time, row.data),
        )
    kept = {end: Path(f"{path}{end}").read_bytes() for end in ("", "-wal", "-shm") if late}
    base.close()  # which empties the log; a recorder that is killed does not
    for end, content in kept.items():
        Path(f"{path}{end}").write_bytes(content)


def write_metadata(folder: Path, files: list[str], rows: list[Row], **more: object) -> dict[str, object]:
    """Write metadata.yaml of version 5 that tells the truth but for ``more``; return what is in it."""
    counts = Counter((row.topic, row.kind) for row in rows)
    about: dict[str, object] = {
        "version": 5,
        "storage_identifier": "sqlite3",
        "relative_file_paths": files,
        "duration": {"nanoseconds": 1},
        "starting_time": {"nanoseconds_since_epoch": START},
        "message_count": len(rows),
        "topics_with_message_count": [
            {
                "topic_metadata": {
                    "name": topic, "type": kind, "serialization_format": "cdr", "offered_qos_profiles": QOS,
                },
                "message_count": count,
            }
            for (topic, kind), count in counts.items()
        ],
        "compression_format": "",
        "compression_mode": "",
    }  # fmt: skip
    about |= more
    (folder / "metadata.yaml").write_text(yaml.safe_dump({"rosbag2_bagfile_information": about}))
    return about


def write_bag(folder: Path, rows: list[Row], late: int = 0, **more: object) -> Path:
    folder.mkdir()
    write_db3(folder / "bag_0.db3", rows, late=late)
    write_metadata(folder, ["bag_0.db3"], rows, **more)
    return folder


def write_mcap(path: Path, rows: list[Row], packed: bool = False) -> None:
    """Write an MCAP with publish times, numbers, an attachment and metadata; ``packed``: each message by zstd."""
    with path.open("wb") as stream:
        writer = McapWriter(stream)
        writer.start("ros2", "test")
        channels: dict[tuple[str, str], int] = {}
        for number, row in enumerate(rows):
            if (row.topic, row.kind) not in channels:
                definition = SCHEMA_TEXT[PLAIN] if row.kind == PLAIN else "string data\n"
                schema = writer.register_schema(row.kind, "ros2msg", definition.encode())
                facts = {"offered_qos_profiles": QOS}
                channels[row.topic, row.kind] = writer.register_channel(row.topic, "cdr", schema, facts)
            data = zstandard.compress(row.data) if packed else row.data
            writer.add_message(channels[row.topic, row.kind], row.time, data, row.time - 7, number + 100)
        writer.add_attachment(5, START, "calibration.json", "application/json", b"{}")
        writer.add_metadata("vehicle", {"name": "blue"})
        writer.finish()


def run(log: Path, out: Path, **options: object) -> Path:
    """Archive a log; return the archive."""
    config = RunConfig(source="bag", keep_movable=True, effort="fast", gop=2, **options)
    graph = GraphOptions(overwrite=True)
    request = RunRequest(config, [log.stem], out, log, workers=0, graph=graph, quiet=True)
    assert not run_sequences(request).failed
    return out / "archives" / f"{log.stem}.mcap"


def there_and_back(log: Path, out: Path) -> Path:
    """Archive a log, verify it against the log, decode it; return the MCAP file."""
    path = run(log, out)
    verdict = verify(path, log)
    assert verdict.good, verdict.problems
    archive = Archive.open(path)
    (back,) = EXPORTS["mcap"](archive, iter(archive), out / "back")
    return back


def read_mcap(path: Path) -> list[tuple[str, int, bytes]]:
    """All messages, by mcap's own reader."""
    with path.open("rb") as stream:
        return sorted((c.topic, m.log_time, m.data) for _, c, m in make_reader(stream).iter_messages())


def told(rows: list[Row]) -> list[tuple[str, int, bytes]]:
    return sorted((row.topic, row.time, row.data) for row in rows)


# What SQLite holds


def test_messages_that_a_killed_recorder_left_in_the_write_ahead_log_come_back(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "killed", drive(), late=3)
    before = sorted((file.name, file.read_bytes()) for file in bag.iterdir())
    assert read_mcap(there_and_back(bag, tmp_path / "out")) == told(drive())
    assert before == sorted(
        (file.name, file.read_bytes()) for file in bag.iterdir()
    )  # nothing is written there
    (bag / "bag_0.db3-wal").unlink()
    with pytest.warns(LogWarning, match="says 3 messages of /texts, the files hold 1"):
        Bag().scans(bag, "killed")
    assert "topic /texts: 3 messages in the archive, 1 counted" in _problems(tmp_path / "out", bag)


def _problems(out: Path, log: Path) -> list[str]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", LogWarning)
        return verify(out / "archives" / f"{log.stem}.mcap", log).problems


def test_a_rollback_journal_is_rolled_back(tmp_path: Path) -> None:
    """A recorder that was killed amid a transaction: what it had not finished is not there."""
    bag = write_bag(tmp_path / "hot", drive())
    base = sqlite3.connect(bag / "bag_0.db3", isolation_level=None)
    base.execute("PRAGMA cache_size = 1")
    base.execute("BEGIN")
    base.execute("UPDATE messages SET timestamp = timestamp + 1")
    base.execute("PRAGMA cache_spill = 1")
    for number in range(200):  # until pages are written before the end of the transaction
        base.execute(
            "INSERT INTO messages(topic_id, timestamp, data) VALUES(1, 1, ?)", (bytes(900 + number),)
        )
    copies = {end: Path(f"{bag / 'bag_0.db3'}{end}").read_bytes() for end in ("", "-journal")}
    base.rollback()
    base.close()
    for end, content in copies.items():
        Path(f"{bag / 'bag_0.db3'}{end}").write_bytes(content)
    assert copies["-journal"] and read_mcap(there_and_back(bag, tmp_path / "out")) == told(drive())


def test_files_that_overlap_in_time_keep_both_clouds_of_a_time(tmp_path: Path) -> None:
    bag = tmp_path / "split"
    bag.mkdir()
    parts = [drive(0, 3), [cloud(9, START + STEP), *drive(3, 2)]]
    for number, rows in enumerate(parts):
        write_db3(bag / f"split_{number}.db3", rows)
    write_metadata(bag, ["split_0.db3", "split_1.db3"], parts[0] + parts[1])
    assert read_mcap(there_and_back(bag, tmp_path / "out")) == told(parts[0] + parts[1])
    refs = Bag().scans(bag, "split")
    assert len({ref.at for ref in refs}) == len(refs) == 6
    points = {Bag().read(ref, with_labels=False).points.tobytes() for ref in refs}
    assert len(points) == 6


@pytest.mark.parametrize("name", ["run #3", "50%25", "what?", "übung 1", "a&b=c", "mode=ro"])
def test_a_path_is_no_uri(name: str, tmp_path: Path) -> None:
    bag = write_bag(tmp_path / name, drive(count=1))
    assert read_mcap(there_and_back(bag, tmp_path / "out")) == told(drive(count=1))


@pytest.mark.parametrize("change", ["time", "topic", "data"])
def test_a_row_that_no_archive_can_hold_is_refused(change: str, tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "odd", drive())
    base = sqlite3.connect(bag / "bag_0.db3")
    base.execute(
        {
            "time": "UPDATE messages SET timestamp = -5 WHERE id = 2",
            "topic": "UPDATE messages SET topic_id = 77 WHERE id = 2",
            "data": "UPDATE messages SET data = 'words' WHERE id = 2",
        }[change]
    )
    base.commit()
    base.close()
    with pytest.raises(SourceError, match=r"bag_0\.db3: .*row 2"):
        Bag().scans(bag, "odd")


# What metadata.yaml says otherwise


@pytest.mark.parametrize(
    "qos", ["", QOS.replace("durability: 2", "durability: 1"), [{"history": "keep_all"}]]
)
def test_edited_qos_loses_no_message(qos: object, tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "edited", drive())
    about = yaml.safe_load((bag / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    for topic in about["topics_with_message_count"]:
        topic["topic_metadata"]["offered_qos_profiles"] = qos
    write_metadata(bag, ["bag_0.db3"], drive(), **about)
    with pytest.warns(LogWarning, match="stays behind: the QoS that metadata.yaml gives /texts"):
        assert read_mcap(there_and_back(bag, tmp_path / "out")) == told(drive())


def test_topics_that_the_metadata_do_not_tell_come_back(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "few", drive(), topics_with_message_count=[])
    with pytest.warns(LogWarning, match="says 0 messages of /points, the files hold 3"):
        assert read_mcap(there_and_back(bag, tmp_path / "out")) == told(drive())


def test_a_file_that_the_metadata_do_not_list_is_read_and_one_that_is_gone_is_refused(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", drive())
    write_db3(bag / "bag_1.db3", drive(3, 2))
    with pytest.warns(LogWarning) as said:
        assert read_mcap(there_and_back(bag, tmp_path / "out")) == told(drive(0, 5))
    lines = [str(one.message) for one in said]
    assert f"{bag}: bag_1.db3 is not listed in metadata.yaml, and is read all the same" in lines
    assert any("says 3 messages of /texts, the files hold 5" in line for line in lines)
    (bag / "bag_0.db3").unlink()
    with pytest.raises(SourceError, match=r"lists bag_0\.db3, which is not in the folder"):
        Bag().scans(bag, "bag")


@pytest.mark.parametrize("content", [b"", b"- a\n", b"rosbag2_bagfile_information: 3\n", b"\xff\xfe"])
def test_metadata_that_cannot_be_read_are_refused(content: bytes, tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", drive())
    (bag / "metadata.yaml").write_bytes(content)
    with pytest.raises(SourceError, match=r"metadata\.yaml: cannot be read .*ros2 bag reindex"):
        Bag().scans(bag, "bag")


def test_a_bag_may_have_any_name_and_its_files_too(tmp_path: Path) -> None:
    for name in ("drive.mcap", "drive.bag", "drive.db3", "drive.2026-01-01"):
        bag = write_bag(tmp_path / name, drive(count=1))
        (bag / "bag_0.db3").rename(bag / "messages")
        write_metadata(bag, ["messages"], drive(count=1))
        assert Counter(topic for topic, *_ in told(drive(count=1))) == count_log(bag)
        assert len(Bag().scans(bag, bag.stem)) == 1


def test_two_logs_of_one_name_are_not_guessed_at(tmp_path: Path) -> None:
    write_mcap(tmp_path / "drive.mcap", drive())
    write_bag(tmp_path / "drive", drive(3))
    with pytest.raises(SourceError, match=r"holds drive\.mcap and drive; name the one"):
        Bag().scans(tmp_path, "drive")
    assert len(Bag().scans(tmp_path / "drive", "drive")) == 3


# What rosbag2 compresses


@pytest.mark.parametrize("mode", ["file", "message"])
def test_compressed_mcap_keeps_publish_times_numbers_and_what_it_encloses(mode: str, tmp_path: Path) -> None:
    write_mcap(tmp_path / "plain.mcap", drive())
    bag = tmp_path / "packed"
    bag.mkdir()
    name = "packed_0.mcap.zstd" if mode == "file" else "packed_0.mcap"
    if mode == "file":
        (bag / name).write_bytes(zstandard.compress((tmp_path / "plain.mcap").read_bytes()))
    else:
        write_mcap(bag / name, drive(), packed=True)
    write_metadata(
        bag,
        [name],
        drive(),
        storage_identifier="mcap",
        compression_mode=mode.upper(),
        compression_format="zstd",
    )
    back = there_and_back(bag, tmp_path / "out")
    assert _facts(back) == _facts(tmp_path / "plain.mcap")
    with Rosbag2Reader(back.parent) as reader:  # and whoever plays it finds nothing compressed
        assert len(list(reader.messages())) == 6


def _facts(path: Path) -> object:
    with path.open("rb") as stream:
        reader = make_reader(stream)
        messages = [
            (c.topic, m.log_time, m.publish_time, m.sequence, m.data) for _, c, m in reader.iter_messages()
        ]
        return sorted(messages), list(reader.iter_attachments()), list(reader.iter_metadata())


@pytest.mark.parametrize("mode", ["file", "message"])
def test_compressed_sqlite_comes_back(mode: str, tmp_path: Path) -> None:
    bag = tmp_path / "packed"
    bag.mkdir()
    rows = drive()
    packed = [replace(row, data=zstandard.compress(row.data)) for row in rows]
    write_db3(bag / "packed_0.db3", rows if mode == "file" else packed)
    files = ["packed_0.db3"]
    if mode == "file":
        whole = (bag / "packed_0.db3").read_bytes()
        # In two frames, as tools with several threads write it.
        frames = zstandard.compress(whole[:5000]) + zstandard.compress(whole[5000:])
        (bag / "packed_0.db3.zstd").write_bytes(frames)
        (bag / "packed_0.db3").unlink()
        files = ["packed_0.db3.zstd"]
    write_metadata(bag, files, rows, compression_mode=mode.upper(), compression_format="zstd")
    assert read_mcap(there_and_back(bag, tmp_path / "out")) == told(rows)
    if mode == "file":  # players leave what they decompress beside it
        (bag / "packed_0.db3").write_bytes(whole)
        assert read_mcap(there_and_back(bag, tmp_path / "again")) == told(rows)


def test_a_compressed_file_or_message_that_ends_early_is_refused(tmp_path: Path) -> None:
    bag = tmp_path / "cut"
    bag.mkdir()
    write_db3(tmp_path / "whole.db3", drive())
    packed = zstandard.compress((tmp_path / "whole.db3").read_bytes())
    (bag / "cut_0.db3.zstd").write_bytes(packed[: len(packed) // 2])
    write_metadata(bag, ["cut_0.db3.zstd"], drive(), compression_mode="FILE", compression_format="zstd")
    with pytest.raises(SourceError, match=r"cut_0\.db3\.zstd: ends early"):
        Bag().scans(bag, "cut")
    rows = [replace(row, data=zstandard.compress(row.data)[:-3]) for row in drive()]
    other = write_bag(tmp_path / "torn", rows)
    with pytest.raises(SourceError, match=r"bag_0\.db3: .*compressed message"):
        Bag().scans(other, "torn")
    write_metadata(other, ["bag_0.db3"], rows, compression_mode="FILE", compression_format="lz4")
    with pytest.raises(SourceError, match="compression lz4 is not read"):
        Bag().scans(other, "torn")


# Who published


def test_clouds_of_several_publishers_come_back_on_their_own_channel(tmp_path: Path) -> None:
    """Two that differ in their metadata, two that tell the very same, and one of another topic."""
    path = tmp_path / "many.mcap"
    rows = drive(0, 8)[::2]
    with path.open("wb") as stream:
        writer = McapWriter(stream)
        writer.start("ros2", "test")
        schema = writer.register_schema(PLAIN, "ros2msg", SCHEMA_TEXT[PLAIN].encode())
        facts = [{"who": "a"}, {"who": "b"}, {"who": "b"}]
        channels = [writer.register_channel("/points", "cdr", schema, told) for told in facts]
        texts = [writer.register_channel("/texts", "json", 0, {"who": who}) for who in "ab"]
        for number, row in enumerate(rows):
            writer.add_message(channels[number % 3], row.time, row.data, row.time)
            writer.add_message(texts[number % 2], row.time, b"{}", row.time)
        writer.finish()
    back = there_and_back(path, tmp_path / "out")
    assert _by_channel(back) == _by_channel(path)
    assert len(_by_channel(back)) == 5


def _by_channel(path: Path) -> list[object]:
    """For each channel, what it tells and its messages; not its number, nor the order."""
    found: dict[int, tuple[object, list[object]]] = {}
    with path.open("rb") as stream:
        for schema, channel, message in make_reader(stream).iter_messages():
            facts = channel.topic, schema.name if schema else "", sorted(channel.metadata.items())
            found.setdefault(channel.id, (facts, []))[1].append((message.log_time, message.data))
    return sorted(found.values(), key=str)


def ros1_cloud(number: int) -> bytes:
    """The same cloud in ROS 1's bytes, with a number in its header."""
    data = cloud(number, START + number * STEP).data
    return struct.pack("<I", number) + bytes(get_typestore(Stores.ROS2_HUMBLE).cdr_to_ros1(data, PLAIN))[4:]


Connections = dict[str, tuple[str, str, str | None, str | None, str | None, int | None]]


def write_ros1(path: Path, connections: Connections, rows: list[tuple[str, int, bytes]]) -> None:
    """Write a bag; of a connection topic, type, definition, md5sum, caller, latching."""
    with Rosbag1Writer(path) as writer:
        open_ = {}
        for name, (topic, kind, definition, md5sum, caller, latching) in connections.items():
            store = get_typestore(Stores.ROS1_NOETIC) if definition is None else None
            open_[name] = writer.add_connection(
                topic,
                kind,
                typestore=store,
                msgdef=definition,
                md5sum=md5sum,
                callerid=caller,
                latching=latching,
            )
        for name, time, data in rows:
            writer.write(open_[name], time, data)


def read_ros1(path: Path) -> list[tuple[object, ...]]:
    with Rosbag1Reader(path) as reader:
        return sorted(
            (c.topic, c.msgtype, c.digest, c.msgdef.data, str(c.ext), time, bytes(data))
            for c, time, data in reader.messages()
        )


def test_several_publishers_of_a_topic_come_back_in_ros1(tmp_path: Path) -> None:
    """Two callers of the clouds, clouds of the same time on both, and another type on the same topic."""
    path = tmp_path / "two.bag"
    connections: Connections = {
        "a": ("/points", PLAIN, None, None, "/driver_a", None),
        "s": ("/points", STRING, None, None, "/oddity", 1),
        "b": ("/points", PLAIN, None, None, "/driver_b", 1),
    }
    times = [START + n // 2 * STEP for n in range(6)]
    rows = [("ab"[n % 2], times[n], ros1_cloud(n)) for n in range(6)]
    rows += [("s", time, b"\2\0\0\0hi") for time in times]
    write_ros1(path, connections, rows)
    archive = run(path, tmp_path / "out")
    assert verify(archive, path).good
    opened = Archive.open(archive)
    (back,) = EXPORTS["bag"](opened, iter(opened), tmp_path / "back")
    assert read_ros1(back) == read_ros1(path)


def test_ros1_messages_of_one_time_are_told_apart(tmp_path: Path) -> None:
    """By their place in the bag, whatever else is asked for: a reader of fewer connections counts others."""
    path = tmp_path / "same.bag"
    connections: Connections = {
        "s": ("/points", STRING, None, None, None, None),
        "a": ("/points", PLAIN, None, None, None, None),
    }
    write_ros1(
        path, connections, [("s", START, b"\1\0\0\0x")] + [("a", START, ros1_cloud(n)) for n in range(3)]
    )
    refs = Bag().scans(path, "same")
    read = {Bag().read(ref, with_labels=False).points.tobytes() for ref in refs}
    assert len(read) == len({ref.at for ref in refs}) == 3


# Definitions of ROS 1


@pytest.mark.parametrize("definition", ["", "# none\n\n"])
def test_a_type_without_definition_does_not_end_the_export(definition: str, tmp_path: Path) -> None:
    path = tmp_path / "empty.bag"
    store = get_typestore(Stores.ROS1_NOETIC)
    sums = {kind: store.generate_msgdef(kind)[1] for kind in (PLAIN, STRING)}
    connections: Connections = {
        "p": ("/points", PLAIN, definition, sums[PLAIN], None, None),
        "s": ("/texts", STRING, definition, sums[STRING], None, None),
        "q": ("/packets", "rslidar_msgs/msg/rslidarPacket", definition, "1" * 32, None, None),
        "e": ("/tick", "std_msgs/msg/Empty", definition, "d41d8cd98f00b204e9800998ecf8427e", None, None),
        "o": ("/old", "std_msgs/msg/Header", definition, "2" * 32, None, None),
    }
    rows = [("p", START + n * STEP, ros1_cloud(n)) for n in range(2)]
    rows += [("s", START, b"\2\0\0\0hi"), ("q", START, b"\1\2\3"), ("e", START, b""), ("o", START, b"\7" * 9)]
    write_ros1(path, connections, rows)
    back = there_and_back(path, tmp_path / "out")
    with back.open("rb") as stream:
        found = {(c.topic, c.message_encoding, m.data) for _, c, m in make_reader(stream).iter_messages()}
    assert {(topic, encoding) for topic, encoding, _ in found} == {
        ("/points", "cdr"), ("/texts", "cdr"), ("/packets", "ros1"), ("/tick", "cdr"), ("/old", "ros1"),
    }  # fmt: skip
    assert _said(tmp_path, "empty") == [
        "/packets: no definition of rslidar_msgs/rslidarPacket can be read; its messages stay ROS 1's",
        "/old: no definition of std_msgs/Header can be read; its messages stay ROS 1's",
    ]
    assert {("/packets", "ros1", b"\1\2\3"), ("/old", "ros1", b"\7" * 9)} <= found
    with Rosbag2Reader(back.parent) as reader:
        assert len(list(reader.messages([c for c in reader.connections if c.topic == "/points"]))) == 2
    archive = Archive.open(tmp_path / "out" / "archives" / "empty.mcap")
    (bag,) = EXPORTS["bag"](archive, iter(archive), tmp_path / "bag")
    assert read_ros1(bag) == read_ros1(path)


def _said(folder: Path, name: str) -> list[str]:
    """What decoding to MCAP tells, but for header.seq."""
    archive, said = Archive.open(folder / "out" / "archives" / f"{name}.mcap"), []
    list(EXPORTS["mcap"](archive, iter(archive), folder / "said", said.append))
    return [line for line in said if "header.seq" not in line]


def test_bytes_that_are_no_message_of_their_type_stay_as_they_are(tmp_path: Path) -> None:
    path = tmp_path / "odd.bag"
    connections: Connections = {
        "p": ("/points", PLAIN, None, None, None, None),
        "s": ("/texts", STRING, None, None, None, None),
    }
    rows = [("p", START, ros1_cloud(0)), ("s", START, b"\2\0\0\0hi"), ("s", START + 1, b"\xff\0\0\0hi")]
    write_ros1(path, connections, rows)
    back = there_and_back(path, tmp_path / "out")
    with back.open("rb") as stream:
        found = [(c.topic, c.message_encoding, m.data) for _, c, m in make_reader(stream).iter_messages()]
    assert len(found) == 3 and ("/texts", "ros1", b"\xff\0\0\0hi") in found
    assert [encoding for topic, encoding, _ in found if topic == "/texts"] == ["cdr", "ros1"]
    assert _said(tmp_path, "odd") == [
        "/texts: 1 messages are no std_msgs/String; they stay as they are, ROS 1's"
    ]


# Times


def test_times_over_two_to_the_63_come_back(tmp_path: Path) -> None:
    path = tmp_path / "late.mcap"
    times = [2**31 * 10**9, 2**63 - 1, 2**63 + 5, 2**64 - 1]
    with path.open("wb") as stream:
        writer = McapWriter(stream)
        writer.start("ros2", "test")
        schema = writer.register_schema(PLAIN, "ros2msg", SCHEMA_TEXT[PLAIN].encode())
        points = writer.register_channel("/points", "cdr", schema)
        notes = writer.register_channel("/notes", "json", 0)
        for number, time in enumerate(times):
            for publish in (time, 0, 2**64 - 1):
                data = cloud(number, START).data
                writer.add_message(points, time, data, publish, number)
                writer.add_message(notes, time, b"{}", publish, number)
        writer.finish()
    back = there_and_back(path, tmp_path / "out")
    assert _facts(back) == _facts(path)
    with Rosbag2Reader(back.parent) as reader:
        assert reader.message_count == 12


# A folder without metadata.yaml


def test_a_folder_without_metadata_is_its_only_file_or_says_what_to_do(
    tmp_path: Path, command: Command
) -> None:
    bag = tmp_path / "lost"
    bag.mkdir()
    write_db3(bag / "lost_0.db3", drive(), late=3)
    code, _ = command(
        "run", "log", bag, "--keep-movable", "--effort", "fast", "--workers", "0", "--out", tmp_path / "out"
    )
    assert code == 0
    archive = Archive.open(tmp_path / "out" / "archives" / "lost_0.mcap")
    (back,) = EXPORTS["mcap"](archive, iter(archive), tmp_path / "back")
    assert read_mcap(back) == told(drive())
    write_db3(bag / "lost_1.db3", drive(3))
    code, said = command("run", "log", bag, "--keep-movable", "--out", tmp_path / "other")
    assert code == 2 and "name one of lost_0, lost_1" in said and "ros2 bag reindex" in said
    assert not (tmp_path / "other").exists()


# Counted twice


def _kinds(folder: Path) -> dict[str, Path]:
    """The same drive as each kind of log."""
    rows = drive()
    write_mcap(folder / "mcap.mcap", rows)
    with (folder / "plain.mcap").open("wb") as stream:  # neither index nor chunks nor summary
        writer = McapWriter(stream, use_chunking=False, use_statistics=False, repeat_channels=False)
        writer.start("ros2", "test")
        schema = writer.register_schema(PLAIN, "ros2msg", SCHEMA_TEXT[PLAIN].encode())
        channels = {
            "/points": writer.register_channel("/points", "cdr", schema),
            "/texts": writer.register_channel("/texts", "cdr", 0),
        }
        for row in rows:
            writer.add_message(channels[row.topic], row.time, row.data, row.time)
        writer.finish()
    write_bag(folder / "sqlite", rows)
    connections: Connections = {
        "/points": ("/points", PLAIN, None, None, None, None),
        "/texts": ("/texts", STRING, None, None, None, None),
    }
    ros1 = [
        (row.topic, row.time, ros1_cloud(n) if row.kind == PLAIN else b"\0\0\0\0")
        for n, row in enumerate(rows)
    ]
    write_ros1(folder / "ros1.bag", connections, ros1)
    return {name: find_log(folder, name) for name in ("mcap", "plain", "sqlite", "ros1")}


def test_every_kind_of_log_is_counted_without_its_reader(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kinds = _kinds(tmp_path)
    for reader in (McapLog, SqliteLog):
        monkeypatch.setattr(reader, "__init__", None)
    for path in kinds.values():
        assert count_log(path) == {"/points": 3, "/texts": 3}


@pytest.mark.parametrize("kind", ["mcap", "plain", "sqlite", "ros1"])
@pytest.mark.parametrize("topic", ["/points", "/texts"])
def test_a_reader_that_passes_a_message_over_is_found_out(
    topic: str, kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = _kinds(tmp_path)[kind]
    reader = type(open_log(path))
    messages = reader.messages

    def all_but_one(log: object, *wanted: object) -> Iterator[LogMessage]:
        left = iter([True])
        for message in messages(log, *wanted):
            if log.channels[message.channel].topic != topic or not next(left, False):
                yield message

    archive = run(path, tmp_path / "whole")
    monkeypatch.setattr(reader, "messages", all_but_one)
    with pytest.raises(SalpccError, match=f"topic {topic}: 2 messages read, 3 counted"):
        run(path, tmp_path / "out")
    assert not (tmp_path / "out").exists()
    monkeypatch.undo()
    # An archive that lacks one, and a log that is read without it: the count alone tells.
    less = _without_one(topic, path, tmp_path / "less", monkeypatch)
    assert verify(archive, path).good
    monkeypatch.setattr(reader, "messages", all_but_one)
    monkeypatch.setattr(
        "salpcc.stages.ingest.sources.bag.count_log",
        lambda _: Counter({"/points": 3, "/texts": 3}) - Counter([topic]),
    )
    assert verify(less, path).problems == [
        f"topic {topic}: 2 messages of {path} are read, 3 counted",
        f"topic {topic}: 2 messages in the archive, 3 counted",
    ]


def _without_one(topic: str, path: Path, out: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Make an archive by a reader that passes the first message of a topic over, with nobody who counts."""
    reader = type(open_log(path))
    messages = reader.messages

    def all_but_one(log: object, *wanted: object) -> Iterator[LogMessage]:
        left = iter([True])
        for message in messages(log, *wanted):
            if log.channels[message.channel].topic != topic or not next(left, False):
                yield message

    with monkeypatch.context() as patch:
        patch.setattr(reader, "messages", all_but_one)
        for where in ("salpcc.stages.ingest.sources.bag", "salpcc.pipeline.plan.logs"):
            patch.setattr(f"{where}.differences", lambda *_: [])
        return run(path, out)


def test_what_neither_is_coded_nor_passes_makes_no_archive(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = _kinds(tmp_path)["mcap"]
    opened = open_log(path)
    gone = next(m for m in opened.messages() if opened.channels[m.channel].topic == "/texts")
    messages = McapLog.messages
    passing = bag.Bag.passing

    def less(*given: Any) -> PassingLog:
        with monkeypatch.context() as patch:
            patch.setattr(bag, "open_log", lambda p: _Less(p, gone.at, messages))
            return passing(*given)

    monkeypatch.setattr(bag.Bag, "passing", less)
    with pytest.raises(SourceError, match="topic /texts: 2 messages to keep, 3 counted"):
        run(path, tmp_path / "out")
    assert not (tmp_path / "out" / "archives" / "mcap.mcap").exists()


class _Less(McapLog):
    def __init__(self, path: Path, gone: tuple[int, ...], messages: object) -> None:
        super().__init__([path])
        self._gone, self._all = gone, messages

    def messages(self, channels: set[int] | None = None) -> Iterator[LogMessage]:
        return (m for m in self._all(self, channels) if m.at != self._gone)


def test_statistics_that_lie_are_refused_with_both_numbers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "lie.mcap"
    write = Statistics.write

    def lie(told: Statistics, stream: object) -> None:
        counts = {channel: number + 1 for channel, number in told.channel_message_counts.items()}
        write(replace(told, channel_message_counts=counts, message_count=sum(counts.values())), stream)

    with monkeypatch.context() as patch:
        patch.setattr(Statistics, "write", lie)
        write_mcap(path, drive())
    with pytest.raises(SourceError, match="topic /points: 3 messages read, 4 counted"):
        Bag().scans(path, "lie")


def test_a_run_of_some_frames_verifies_and_one_of_all_is_made_anew(tmp_path: Path) -> None:
    path = tmp_path / "some.mcap"
    write_mcap(path, [text("before", START - 9), *drive()])
    archive = run(path, tmp_path / "out", frames=(0, 3))
    verdict = verify(archive, path)
    assert verdict.good and verdict.passed_messages == 2
    assert Archive.open(archive).config["frames"] == [0, 3]
    verdict = verify(run(path, tmp_path / "out"), path)
    assert verdict.good and verdict.passed_messages == 4


# What stays behind is said


def test_what_an_archive_cannot_hold_is_said_before_anything_is_written(
    tmp_path: Path, command: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    plain = tmp_path / "plain.mcap"
    write_mcap(plain, drive())
    raw = plain.read_bytes()
    # A private record and a schema of no channel right behind the header, whose profile is another.
    length = struct.unpack_from("<Q", raw, 9)[0]
    behind = 8 + 9 + length
    header = b"\1" + struct.pack("<Q", 4 + 7 + 4) + b"\7\0\0\0private\0\0\0\0"
    private = b"\x91" + struct.pack("<Q", 3) + b"abc"
    spare = struct.pack("<H", 99) + b"\5\0\0\0Spare" + b"\0" * 8
    path = tmp_path / "odd.mcap"
    data_end = raw.index(b"\x0f" + struct.pack("<Q", 4), behind)
    path.write_bytes(
        raw[:8] + header + private + b"\3" + struct.pack("<Q", len(spare)) + spare + raw[behind:data_end]
        + b"\x0f" + struct.pack("<QI", 4, 0) + b"\2" + struct.pack("<QQQI", 20, 0, 0, 0) + raw[:8]
    )  # fmt: skip
    bag = write_bag(tmp_path / "bag", drive(), custom_data={"driver": "me"})
    (bag / "notes.txt").write_text("rain")
    base = sqlite3.connect(bag / "bag_0.db3")
    base.execute("CREATE TABLE mine(id INTEGER)")
    base.execute("ALTER TABLE messages ADD COLUMN sent INTEGER")
    base.commit()
    base.close()
    ros1, write = tmp_path / "ros1.bag", Header.write

    def write_more(header: Header, *where: object) -> int:
        if "message_definition" in header:
            header["tcp_nodelay"] = b"1"
        return int(write(header, *where))

    with monkeypatch.context() as patch:
        patch.setattr(Header, "write", write_more)
        write_ros1(ros1, {"p": ("/points", PLAIN, None, None, None, None)}, [("p", START, ros1_cloud(0))])
    for log, lines in (
        (path, ["1 records of the private kind 0x91", "the schema Spare", "the profile private"]),
        (bag, ["custom_data", "notes.txt beside the bag", "the table mine", "the column sent of messages"]),
        (ros1, ["tcp_nodelay in a header of /points"]),
    ):
        out = tmp_path / f"out_{log.stem}"
        code, said = command(
            "run", "log", log, "--keep-movable", "--effort", "fast", "--workers", "0", "--out", out
        )
        assert code == 0 and said.count("stays behind: ") == len(lines), said
        for line in lines:
            assert any(line in one and one.startswith("note: ") for one in said.splitlines()), said


def test_clouds_that_cannot_be_coded_are_kept_and_that_is_said(tmp_path: Path, command: Command) -> None:
    rows = drive()
    rows[2] = replace(rows[2], data=rows[2].data[:-60])
    path, out = tmp_path / "cut.mcap", tmp_path / "out"
    write_mcap(path, rows)
    code, said = command(
        "run", "log", path, "--keep-movable", "--effort", "fast", "--workers", "0", "--out", out
    )
    assert code == 1 and "failed: cut/000001" in said
    assert "note: cut: 1 that failed are in the archive as they were recorded" in said
    verdict = verify(out / "archives" / "cut.mcap", path)
    assert verdict.good and (verdict.scans, verdict.passed_messages) == (2, 4)


# The wrong file


@pytest.fixture
def command(cli: Callable[..., Any]) -> Command:
    """The command line: exit code, and what it says besides its output."""

    def call(*words: object) -> tuple[int, str]:
        done = cli(*words)
        return done.returncode, done.stderr

    return call


@pytest.mark.parametrize("name", ["notes.txt", "notes.mcap", "notes.bag", "notes.db3", "empty.mcap"])
@pytest.mark.parametrize("words", [("run", "log"), ("verify",), ("recover",)])
def test_a_file_that_is_something_else_is_named(
    words: tuple[str, ...], name: str, tmp_path: Path, command: Command
) -> None:
    file = tmp_path / name
    file.write_text("" if name.startswith("empty") else "Rain in the morning, no sun.\n" * 20)
    out = [] if words == ("verify",) else ["--out", tmp_path / "out"]
    code, said = command(*words, file, *out)
    assert code in (1, 2) and said.count("\n") == 1 and name in said, said
    assert ("an empty file" if name.startswith("empty") else "a text file") in said or "empty" in said
    assert "sensor model" not in said and not (tmp_path / "out").exists()


def test_an_mcap_without_clouds_and_an_archive_are_named(tmp_path: Path, command: Command) -> None:
    plain = tmp_path / "plain.mcap"
    write_mcap(plain, [text("hi", START)])
    code, said = command("run", "log", plain, "--out", tmp_path / "out")
    assert code == 2 and "no point clouds" in said and "/texts (std_msgs/msg/String)" in said
    for words in (("verify", plain), ("recover", plain, "--out", tmp_path / "new.mcap")):
        code, said = command(*words)
        assert code == 1 and "an MCAP file" in said and "salpcc-pipeline run log" in said
    write_mcap(tmp_path / "log.mcap", drive())
    archive = run(tmp_path / "log.mcap", tmp_path / "done")
    code, said = command("run", "log", archive, "--out", tmp_path / "out")
    assert code == 2 and "an archive of salpcc-pipeline" in said and "decode" in said
    code, said = command("verify", archive, "--against", archive)
    assert code == 2 and "an archive of salpcc-pipeline" in said
    empty = tmp_path / "empty.mcap"
    with empty.open("wb") as stream:
        writer = McapWriter(stream)
        writer.start("ros2", "test")
        writer.register_channel("/points", "cdr", writer.register_schema(PLAIN, "ros2msg", b""))
        writer.finish()
    code, said = command("run", "log", empty, "--out", tmp_path / "out")
    assert code == 2 and "no messages on /points" in said and "frames" not in said
    assert not (tmp_path / "out").exists()
