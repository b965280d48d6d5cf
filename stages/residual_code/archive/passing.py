"""What passes through an archive untouched: the messages of a log that are no point clouds of ours.

They keep channel, times, number and bytes. Their channels have the ids of the log plus one, for the coded
scans are channel 1. What the log encloses (attachments, metadata) passes through with a prefix to its name.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import Any

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, Message, MessageIndex, Metadata, Schema

from salpcc.schemas.log import Enclosed, LogChannel, LogMessage, LogMetadata
from salpcc.schemas.mcap_chunks import compress, enclosed_record, read_enclosed, records, stream

ENCLOSED = "log:"  # before the names of what a log encloses, so that they are none of an archive's own
_CHECK = "log:crc"


def passing_records(channel: LogChannel) -> tuple[list[Schema], Channel]:
    """Return the records that tell a channel in an archive: its schema, if it has one, and itself."""
    number = channel.id + 1
    schema = []
    if channel.type or channel.schema:
        schema.append(Schema(number, channel.schema, channel.schema_encoding, channel.type))
    metadata = dict(channel.metadata)
    return schema, Channel(number, channel.topic, channel.encoding, metadata, number if schema else 0)


def channel_document(channel: LogChannel) -> dict[str, Any]:
    """Return a channel as JSON; the bytes of its schema are characters of that number."""
    return {**vars(channel), "schema": channel.schema.decode("latin-1"), "metadata": dict(channel.metadata)}


def channel_of_document(document: dict[str, Any]) -> LogChannel:
    """Return the channel; inverse of :func:`channel_document`.

    Raises:
        ValueError, KeyError, TypeError: it is none.
    """
    texts = {name: str(document[name]) for name in ("topic", "encoding", "type", "schema_encoding", "schema")}
    metadata = tuple(sorted((str(key), str(value)) for key, value in document["metadata"].items()))
    schema = texts.pop("schema").encode("latin-1")
    return LogChannel(id=int(document["id"]), schema=schema, metadata=metadata, **texts)


def passing_channel(channel: Channel, schema: Schema | None) -> LogChannel:
    """Return the channel of the log; inverse of :func:`passing_records`."""
    metadata = tuple(sorted(channel.metadata.items()))
    kind = (schema.name, schema.encoding, bytes(schema.data)) if schema else ("", "", b"")
    return LogChannel(channel.id - 1, channel.topic, channel.message_encoding, *kind, metadata)


def passing_enclosed(found: Enclosed) -> Attachment | Metadata:
    """Return the record of what a log encloses; metadata get a checksum, which the format gives to attachments only."""
    record = enclosed_record(replace(found, name=ENCLOSED + found.name))
    if isinstance(record, Metadata):
        key = _CHECK
        while key in record.metadata:
            key += "_"
        record.metadata[key] = _checksum(found)
    return record


def read_passing_enclosed(opcode: int, content: bytes) -> Enclosed:
    """Read such a record; inverse of :func:`passing_enclosed`.

    Raises:
        ValueError: it is damaged.
    """
    found = read_enclosed(opcode, content)
    found = replace(found, name=found.name.removeprefix(ENCLOSED))
    if isinstance(found, LogMetadata):
        *facts, (_, checksum) = found.facts
        found = replace(found, facts=tuple(facts))
        if checksum != _checksum(found):
            raise ValueError("the metadata are damaged (CRC differs)")
    return found


def _checksum(found: Enclosed) -> str:
    builder = RecordBuilder()
    enclosed_record(found).write(builder)
    return f"{zlib.crc32(builder.end()):08x}"


def passing_chunk(messages: Iterable[LogMessage]) -> tuple[Chunk, list[MessageIndex]]:
    """Put messages into a chunk; also its indexes, one a channel."""
    builder = RecordBuilder()
    places: dict[int, list[tuple[int, int]]] = {}
    for message in messages:
        number = message.channel + 1
        places.setdefault(number, []).append((message.log_time, builder.count))
        Message(number, message.log_time, message.data, message.publish_time, message.sequence).write(builder)
    data = bytes(builder.end())
    times = [time for rows in places.values() for time, _ in rows]
    chunk = Chunk("zstd", compress(data), max(times), min(times), zlib.crc32(data), len(data))
    return chunk, [MessageIndex(number, rows) for number, rows in sorted(places.items())]


def passing_messages(data: bytes, channels: dict[int, LogChannel]) -> Iterator[LogMessage]:
    """Yield the messages of a chunk; inverse of :func:`passing_chunk`.

    Raises:
        KeyError: a message of a channel that is not there.
    """
    for opcode, at, content in records(data):
        if opcode == Opcode.MESSAGE:
            found = Message.read(stream(content), len(content))
            channel = channels[found.channel_id - 1].id
            yield LogMessage(
                channel, found.log_time, found.publish_time, found.sequence, bytes(found.data), (at,)
            )
