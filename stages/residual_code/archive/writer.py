"""Write an archive. Chunk boundaries are GOPs, and no library version and no clock enters the bytes.

The records are the ``mcap`` package's; its writer is not used, because it cuts chunks by size and signs
the file with its own version.
"""

from __future__ import annotations

import json
import struct
import zlib
from collections.abc import Iterable
from itertools import count
from pathlib import Path
from typing import Any, BinaryIO

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Message,
    MessageIndex,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
)

from salpcc.schemas.files import atomic
from salpcc.schemas.labels import CLASSES, GROUPS
from salpcc.schemas.log import Enclosed, LogChannel, LogMessage
from salpcc.schemas.messages import COMPRESSED, LABEL, SCHEMA_TEXT, CloudMessage
from salpcc.schemas.passing_log import PassingLog
from salpcc.stages.residual_code.archive.documents import pack_document
from salpcc.stages.residual_code.archive.format import (
    ARCHIVE_VERSION,
    DESCRIPTION,
    DIGITS,
    GOP_HEAD,
    GOP_OPCODE,
    INDEX,
    LIBRARY,
    MAGIC,
    OWN_TOPICS,
    TOPIC,
    ArchiveFacts,
    ScanPayload,
    row_of,
    sequence_number,
)
from salpcc.stages.residual_code.archive.passing import (
    channel_document,
    passing_chunk,
    passing_enclosed,
    passing_records,
)
from salpcc.stages.residual_code.archive.side_files import SideFile, side_record


def message_of(payload: ScanPayload, place: int, version: str = ARCHIVE_VERSION, channel: int = 1) -> Message:
    """The message of one scan, or one layer of it; ``place`` is the number of scans before it."""
    cloud = CloudMessage(
        payload.time,
        payload.frame_id,
        payload.entry.kept,
        payload.data,
        format=f"salpcc/{version}",
        is_dense=payload.entry.strays == 0,
    )
    number = sequence_number(payload.entry.name, place)
    return Message(channel, payload.time, cloud.to_cdr(), payload.time, number)


def labels_message(payload: ScanPayload, place: int, channel: int) -> Message:
    """The message of the labels of a scan's layer."""
    cloud = CloudMessage(
        payload.time,
        payload.frame_id,
        payload.entry.kept,
        payload.labels,
        format=f"salpcc-labels/{ARCHIVE_VERSION}",
        point_step=4,
        fields=LABEL,
    )
    number = sequence_number(payload.entry.name, place)
    return Message(channel, payload.time, cloud.to_cdr(), payload.time, number)


def own_channels(facts: ArchiveFacts, log: Iterable[LogChannel]) -> dict[str, int]:
    """Return the ids of the channels that are an archive's own, by name: the first that no channel of the log has."""
    taken = {channel.id + 1 for channel in log}
    free = (number for number in count(2) if number not in taken)
    return dict(zip(facts.channels, free, strict=False))


class ArchiveWriter:
    """Writes an archive GOP by GOP; inverse of :class:`~salpcc.stages.residual_code.archive.reader.ArchiveReader`."""

    def __init__(self, stream: BinaryIO, facts: ArchiveFacts, log: Iterable[LogChannel] = ()) -> None:
        """Write what stands before the scans; ``log``: channels whose messages pass through as they are."""
        self._stream = stream
        self._at = 0
        self._crc = 0
        self._index: list[list[list[Any]]] = []
        self._movable_index: list[list[list[Any]]] = []
        self._version = facts.version
        log = sorted(log, key=lambda channel: channel.id)
        self._own = own_channels(facts, log)
        self._chunks: list[McapRecord] = []
        self._attachments: list[McapRecord] = []
        self._metadata: list[McapRecord] = []
        self._times: list[int] = []
        self._counts = {1: 0}
        self._sequence = facts.sequence
        self._schemas: list[McapRecord] = [Schema(1, SCHEMA_TEXT[COMPRESSED].encode(), "ros2msg", COMPRESSED)]
        # The ros2 profile asks for the QoS key.
        self._channels: list[McapRecord] = [Channel(1, TOPIC, "cdr", {"offered_qos_profiles": ""}, 1)]
        for name, number in self._own.items():
            self._channels.append(Channel(number, OWN_TOPICS[name], "cdr", {"offered_qos_profiles": ""}, 1))
            self._counts[number] = 0
        # Those that hold clouds have messages here only where a cloud cannot be coded.
        described = [channel for channel in log if channel.holds_clouds]
        self._silent = {channel.id + 1: channel for channel in described}
        self._put(MAGIC)
        self._record(Header("ros2", LIBRARY))
        # Everything a decoder needs stands before the first chunk, so a truncated file still decodes.
        for record in [*self._schemas, *self._channels]:
            self._record(record)
        for channel in log:
            if not channel.holds_clouds:
                self._announce(channel)
        told = {
            "archive_version": facts.version,
            "sequence": facts.sequence,
            "sensor": facts.sensor.digest[:DIGITS],
        }
        told |= {f"{name}_channel": str(number) for name, number in self._own.items()}
        self._enclose(Metadata("salpcc", told))
        description = {
            "classes": [
                {"name": c.name, "group": GROUPS[c.group], "colour": list(c.colour)} for c in CLASSES
            ],
            "config": facts.config,
            "inputs": facts.inputs,
            "log": [channel_document(channel) for channel in described],
            "sensor": json.loads(facts.sensor.to_json()),
            "source": facts.source,
        }
        self._attach(DESCRIPTION, description)

    def _announce(self, channel: LogChannel) -> None:
        """Write the records of a channel of the log."""
        schema, passing = passing_records(channel)
        for record in [*schema, passing]:
            self._record(record)
        self._schemas += schema
        self._channels.append(passing)
        self._counts[passing.id] = 0

    def add_gop(self, payloads: list[ScanPayload]) -> None:
        """Write one GOP as one chunk a layer; an empty one (all its scans failed) only holds its number.

        Scans without their movable layer are behind those that have it.
        """
        names = [payload.entry.name for payload in payloads]
        # Before each chunk, so that what is left of a broken file can still be told by name.
        data = pack_document({"gop": len(self._index), "scans": names, "sequence": self._sequence})
        self._put(GOP_HEAD.pack(GOP_OPCODE, 4 + len(data), zlib.crc32(data)) + data)
        self._index.append([row_of(payload.entry) for payload in payloads])
        self._movable_index.append([])
        if not payloads:
            return
        before = self._counts[1]
        self._chunk(payloads, before, 1, self._own.get("labels"))
        if "movable" not in self._own:
            return
        layer = [payload.movable for payload in payloads if payload.movable is not None]
        self._movable_index[-1] += [row_of(payload.entry) for payload in layer]
        if layer:
            self._chunk(layer, before, self._own["movable"], self._own.get("movable_labels"))

    def _chunk(self, payloads: list[ScanPayload], before: int, channel: int, labels: int | None) -> None:
        """Write a layer of one GOP, each scan's labels behind it; ``before``: scans of earlier ones."""
        builder = RecordBuilder()
        offsets: dict[int, list[tuple[int, int]]] = {}
        for place, payload in enumerate(payloads, before):
            messages = [message_of(payload, place, self._version, channel)]
            if labels is not None and payload.labels:
                messages.append(labels_message(payload, place, labels))
            for message in messages:
                offsets.setdefault(message.channel_id, []).append((payload.time, builder.count))
                message.write(builder)
                self._times.append(payload.time)
                self._counts[message.channel_id] += 1
        data = bytes(builder.end())
        times = [payload.time for payload in payloads]
        first, last = min(times), max(times)
        start, length = self._record(Chunk("", data, last, first, zlib.crc32(data), len(data)))
        index_start = self._at
        places = {number: self._record(MessageIndex(number, rows))[0] for number, rows in offsets.items()}
        index_length = self._at - index_start
        self._chunks.append(
            ChunkIndex(length, start, "", len(data), last, index_length, places, first, len(data))
        )

    def pass_messages(self, messages: Iterable[LogMessage]) -> None:
        """Write messages of the log's channels as one compressed chunk."""
        chunk, indexes = passing_chunk(messages)
        for index in indexes:
            if silent := self._silent.pop(index.channel_id, None):
                self._announce(silent)
        start, length = self._record(chunk)
        places, index_start = {}, self._at
        for index in indexes:
            places[index.channel_id], _ = self._record(index)
            self._times += [time for time, _ in index.records]
            self._counts[index.channel_id] += len(index.records)
        self._chunks.append(
            ChunkIndex(
                length,
                start,
                chunk.compression,
                len(chunk.data),
                chunk.message_end_time,
                self._at - index_start,
                places,
                chunk.message_start_time,
                chunk.uncompressed_size,
            )
        )

    def finish(self, enclosed: Iterable[Enclosed] = (), side: Iterable[SideFile] = ()) -> None:
        """Write the index, side files, what the log encloses, and the summary."""
        layers = {"scans": self._index}
        if any(self._movable_index):
            layers["movable"] = self._movable_index
        self._attach(INDEX, layers)
        for file in side:
            self._enclose(side_record(file))
        for found in enclosed:
            self._enclose(passing_enclosed(found))
        self._record(DataEnd(self._crc))
        self._write_summary()
        self._stream.write(MAGIC)

    def _write_summary(self) -> None:
        start = self._at
        statistics = Statistics(
            attachment_count=len(self._attachments),
            channel_count=len(self._channels),
            channel_message_counts=self._counts,
            chunk_count=len(self._chunks),
            message_count=len(self._times),
            message_end_time=max(self._times, default=0),
            message_start_time=min(self._times, default=0),
            metadata_count=len(self._metadata),
            schema_count=len(self._schemas),
        )
        builder = RecordBuilder()
        for record in [
            *self._schemas,
            *self._channels,
            statistics,
            *self._chunks,
            *self._attachments,
            *self._metadata,
        ]:
            record.write(builder)
        summary = bytes(builder.end())
        # The CRC covers the summary and the footer up to the CRC itself.
        head = struct.pack("<BQQQ", Opcode.FOOTER, 20, start, 0)
        self._put(summary)
        self._record(Footer(start, 0, zlib.crc32(head, zlib.crc32(summary))))

    def _attach(self, name: str, content: Any) -> None:
        self._enclose(Attachment(0, 0, name, "", pack_document(content)))

    def _enclose(self, record: Attachment | Metadata) -> None:
        start, length = self._record(record)
        if isinstance(record, Metadata):
            self._metadata.append(MetadataIndex(start, length, record.name))
            return
        times = record.log_time, record.create_time
        index = AttachmentIndex(start, length, *times, len(record.data), record.name, record.media_type)
        self._attachments.append(index)

    def _record(self, record: McapRecord) -> tuple[int, int]:
        builder = RecordBuilder()
        record.write(builder)
        data = bytes(builder.end())
        self._put(data)
        return self._at - len(data), len(data)

    def _put(self, data: bytes) -> None:
        self._stream.write(data)
        self._at += len(data)
        self._crc = zlib.crc32(data, self._crc)


def write_archive(
    path: Path,
    facts: ArchiveFacts,
    gops: Iterable[list[ScanPayload]],
    log: PassingLog | None = None,
    side: Iterable[SideFile] = (),
) -> None:
    """Write a whole archive, atomically; what passes through from a ``log`` stands before later scans.

    ``side`` files are asked for when all scans are written.
    """
    with atomic(path) as stream:
        writer = ArchiveWriter(stream, facts, log.channels if log else ())
        for payloads in gops:
            if log and payloads:
                for messages in log.until(max(payload.time for payload in payloads)):
                    writer.pass_messages(messages)
            writer.add_gop(payloads)
        for messages in log.until(None) if log else ():
            writer.pass_messages(messages)
        writer.finish(log.enclosed if log else (), side)
