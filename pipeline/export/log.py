"""Write a log again: point clouds as messages, and whatever passed through with them.

``--to mcap`` is for the tools of today: a folder that rosbag2 plays, whose one MCAP file Foxglove and RViz
open. A ROS 1 log is translated to ROS 2 on the way. ``--to bag`` gives a ROS 1 log back as it was.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import yaml
from mcap.writer import CompressionType, Writer
from rosbags.interfaces import Connection
from rosbags.rosbag1 import Writer as Rosbag1Writer

from salpcc.pipeline.archive import Archive
from salpcc.pipeline.export.beside import tell_what_stays
from salpcc.pipeline.export.new_files import check_new
from salpcc.pipeline.export.ros2 import ros2_channel
from salpcc.pipeline.export.tell import Tell, in_silence
from salpcc.schemas.errors import UsageError
from salpcc.schemas.files import atomic, atomic_file
from salpcc.schemas.log import LogChannel, LogMessage, LogMetadata
from salpcc.schemas.messages import PLAIN, SCHEMA_TEXT, XYZI, CloudMessage
from salpcc.schemas.scan import Scan
from salpcc.stages.ingest.point_cloud import scan_to_message
from salpcc.stages.ingest.sources.bag import channels_of
from salpcc.stages.ingest.sources.velodyne_bin import points_to_bytes

_LATEST = 2**63 - 1  # nanoseconds; metadata.yaml has no later time
_POINTS = LogChannel(
    1, "/points", "cdr", PLAIN, "ros2msg", SCHEMA_TEXT[PLAIN].encode(), (("offered_qos_profiles", ""),)
)


def to_mcap(archive: Archive, scans: Iterator[Scan], out: Path, tell: Tell = in_silence) -> Iterator[Path]:
    """Write ``out/SEQ/SEQ.mcap`` and ``metadata.yaml``: every message as recorded, ROS 1 as ROS 2.

    Scans that were no messages become ``sensor_msgs/msg/PointCloud2`` of x, y, z, intensity, bits unchanged. Of an
    MCAP file come back the messages, with times and numbers, the channels and schemas, attachments and metadata; not
    the ids of channels, the order of messages of the same time, compression (of messages, too), chunks, indexes, the
    library in the header, schemas that no channel uses. Of ROS 1, ``header.seq`` goes: ROS 2's headers have none;
    messages of a type that is not known, or that are none of their type, stay ROS 1's, on a channel that says so.

    Raises:
        UsageError: one of the two files is there already.
    """
    path = out / archive.sequence / f"{archive.sequence}.mcap"
    check_new(path, path.with_name("metadata.yaml"))
    if any(channel.encoding == "ros1" for channel in archive.log.values()):
        tell("ROS 2 has no header.seq: the numbers in ROS 1 headers stay behind; --to bag keeps them")
    counts: Counter[tuple[str, str, str]] = Counter()
    first, last = _LATEST, 0
    with atomic(path) as stream:
        writer = Writer(stream, compression=CompressionType.ZSTD)
        writer.start(profile="ros2", library="salpcc-pipeline")
        ids: dict[LogChannel, int] = {}
        raw: dict[LogChannel, int] = {}  # of channels some of whose messages are none of their type
        odd: Counter[LogChannel] = Counter()
        translated = {channel: ros2_channel(channel) for channel in channels(archive)}
        for channel, (told, _) in translated.items():
            ids[channel] = _register(writer, told)
            if told.encoding == "cdr":
                counts[_of_bag(told)] += 0
            elif told.encoding == "ros1":
                tell(f"{told.topic}: no definition of {told.type} can be read; its messages stay ROS 1's")
        for found in archive.enclosed():
            if isinstance(found, LogMetadata):
                writer.add_metadata(found.name, dict(found.facts))
            else:
                times = found.create_time, found.log_time
                writer.add_attachment(*times, found.name, found.media_type, found.data)
        for channel, message in messages(archive, scans):
            told, translate = translated[channel]
            data = translate(message.data)
            id_ = ids[channel]
            if data is None:
                data, told = message.data, channel
                id_ = raw[channel] = raw.get(channel) or _register(writer, channel)
                odd[channel] += 1
            writer.add_message(id_, message.log_time, data, message.publish_time, message.sequence)
            first, last = min(first, message.log_time), max(last, message.log_time)
            if told.encoding == "cdr":
                counts[_of_bag(told)] += 1
        writer.finish()
    for channel, count in odd.items():
        tell(f"{channel.topic}: {count} messages are no {channel.type}; they stay as they are, ROS 1's")
    tell_what_stays(archive, "mcap", tell)
    with atomic(path.with_name("metadata.yaml")) as stream:
        stream.write(_metadata(path.name, counts, min(first, last), min(last, _LATEST)).encode())
    yield path


def _register(writer: Writer, channel: LogChannel) -> int:
    schema = (
        writer.register_schema(channel.type, channel.schema_encoding, channel.schema) if channel.type else 0
    )
    return int(writer.register_channel(channel.topic, channel.encoding, schema, dict(channel.metadata)))


def _of_bag(channel: LogChannel) -> tuple[str, str, str]:
    """What metadata.yaml tells of a channel; it has one entry for several that are the same in this."""
    return channel.topic, channel.type, dict(channel.metadata).get("offered_qos_profiles", "")


def to_bag(archive: Archive, scans: Iterator[Scan], out: Path, tell: Tell = in_silence) -> Iterator[Path]:
    """Write ``out/SEQ.bag``, a ROS 1 bag of the very messages that the archive was made from.

    Connections that tell the very same become one.

    Raises:
        UsageError: the log was no ROS 1 bag, or the file is there already.
    """
    if not archive.log or any(channel.encoding != "ros1" for channel in archive.log.values()):
        raise UsageError(f"--to bag: {archive.sequence} was no ROS 1 bag; use --to mcap")
    path = out / f"{archive.sequence}.bag"
    check_new(path)
    with atomic_file(path) as part, Rosbag1Writer(part) as writer:
        connections = {}
        same: dict[LogChannel, Connection] = {}  # by what they tell; the writer takes nothing twice
        for channel in channels(archive):
            facts, told = dict(channel.metadata), replace(channel, id=0)
            connections[channel] = same[told] = same.get(told) or writer.add_connection(
                channel.topic,
                channel.type.replace("/", "/msg/"),
                msgdef=channel.schema.decode(),
                md5sum=facts.get("md5sum", "*"),
                callerid=facts.get("callerid"),
                latching=int(facts["latching"]) if "latching" in facts else None,
            )
        for channel, message in messages(archive, scans):
            writer.write(connections[channel], message.log_time, message.data)
    tell_what_stays(archive, "bag", tell)
    yield path


def channels(archive: Archive) -> list[LogChannel]:
    """The channels of the log that an archive was made of; of one with points where it was none."""
    return list(archive.log.values()) or [_POINTS]


def messages(archive: Archive, scans: Iterator[Scan]) -> Iterator[tuple[LogChannel, LogMessage]]:
    """Merge scans with what passed through, each message behind earlier ones of the other kind."""
    passing = archive.passing()
    waiting = next(passing, None)
    for place, scan in enumerate(scans):
        while waiting is not None and waiting.log_time <= scan.time:
            yield archive.log[waiting.channel], waiting
            waiting = next(passing, None)
        yield _message(archive, scan, place)
    while waiting is not None:
        yield archive.log[waiting.channel], waiting
        waiting = next(passing, None)


def _message(archive: Archive, scan: Scan, place: int) -> tuple[LogChannel, LogMessage]:
    cloud = scan.cloud
    if cloud is not None and not archive.log:  # a file of more than four columns
        return _POINTS, LogMessage(1, scan.time, scan.time, place, scan_to_message(scan))
    if cloud is None:
        data, fields = points_to_bytes(scan.points, scan.intensity), XYZI
        if scan.offset is not None:
            rows = np.frombuffer(data, np.uint8).reshape(-1, 16)
            offset = scan.offset.astype("<i4").view(np.uint8).reshape(-1, 4)
            data, fields = np.hstack([rows, offset]).tobytes(), (*XYZI, ("t", 16, 5, 1))  # int32
        dense = bool(np.isfinite(scan.points).all())
        step = 4 * len(fields)
        message = CloudMessage(
            scan.time, scan.frame_id, len(scan), data, is_dense=dense, point_step=step, fields=fields
        )
        return _POINTS, LogMessage(1, scan.time, scan.time, place, message.to_cdr())
    for channel in channels_of(cloud, archive.log):
        if cloud.channel in (0, channel.id):
            times = scan.time, (scan.time + cloud.delay) % 2**64
            return channel, LogMessage(channel.id, *times, cloud.sequence, scan_to_message(scan))
    raise UsageError(f"{archive.sequence}: the archive does not tell of the topic {cloud.topic}")


def _metadata(file: str, counts: Counter[tuple[str, str, str]], first: int, last: int) -> str:
    """The metadata.yaml that makes a rosbag2 of a folder; version 5, which every distribution since Galactic reads."""
    starts = {"starting_time": {"nanoseconds_since_epoch": first}, "duration": {"nanoseconds": last - first}}
    total = sum(counts.values())
    topics = [
        {
            "topic_metadata": {
                "name": topic,
                "type": kind,
                "serialization_format": "cdr",
                "offered_qos_profiles": qos,
            },
            "message_count": count,
        }
        for (topic, kind, qos), count in counts.items()
    ]
    about = {
        "version": 5,
        "storage_identifier": "mcap",
        **starts,
        "message_count": total,
        "topics_with_message_count": topics,
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [file],
        "files": [{"path": file, **starts, "message_count": total}],
    }
    return str(yaml.safe_dump({"rosbag2_bagfile_information": about}, sort_keys=False))
