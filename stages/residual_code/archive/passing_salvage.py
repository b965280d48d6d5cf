"""What passed through a damaged archive: the chunks of other topics whose CRC holds."""

from __future__ import annotations

import mmap
import re
import struct
import zlib
from collections.abc import Collection, Iterator
from contextlib import suppress
from pathlib import Path

from mcap.opcode import Opcode
from mcap.records import Channel, Schema

from salpcc.schemas.errors import ArchiveError
from salpcc.schemas.log import Enclosed, LogChannel, LogMessage
from salpcc.schemas.mcap_chunks import PARSE_ERRORS, decompress, records, stream
from salpcc.schemas.passing_log import PassingLog
from salpcc.stages.residual_code.archive.format import DESCRIPTION
from salpcc.stages.residual_code.archive.fragments import attachments
from salpcc.stages.residual_code.archive.passing import (
    channel_of_document,
    passing_channel,
    passing_messages,
    read_passing_enclosed,
)
from salpcc.stages.residual_code.archive.reader import ArchiveReader

# A chunk: length below 2^40, times, size and CRC, the name of its compression, length below 2^40.
_CHUNK = re.compile(rb"\x06(?=.{5}\0\0\0.{28}\x04\0\0\0zstd.{5}\0\0\0)", re.DOTALL)
# An attachment or metadata of the log: length below 2^40, of an attachment its times, length of the name, its prefix.
_ENCLOSED = re.compile(rb"\x09(?=.{5}\0\0\0.{16}.{3}\0log:)|\x0c(?=.{5}\0\0\0.{3}\0log:)", re.DOTALL)
_HEAD = 9 + 44
_MOST = 1 << 20  # bytes before the first GOP that channels are looked for in


def passing_log(
    data: mmap.mmap, path: Path, own: Collection[int], listed: int
) -> tuple[PassingLog | None, int]:
    """Return what passes through, None where nothing did, and how many pieces of it are damaged or gone.

    Args:
        own: ids of the channels that are the archive's own, besides that of its scans.
        listed: pieces of it that the summary of the archive lists, as far as that can be read.
    """
    channels = _channels(data, path, {1, *own})
    whole = [at for at in _chunks(data) if _messages(data, at, channels) is not None]
    damaged = sum(1 for _ in _chunks(data)) - len(whole)
    if not channels:
        return None, max(damaged, listed)
    found = (message for at in whole for message in _messages(data, at, channels) or ())
    enclosed, broken = _enclosed(data)
    gone = max(damaged + broken, listed - len(whole) - len(enclosed))
    return PassingLog(channels.values(), found, enclosed), gone


def _enclosed(data: mmap.mmap) -> tuple[list[Enclosed], int]:
    """What the log enclosed and is whole, and how much is not."""
    found: list[Enclosed] = []
    broken = 0
    for match in _ENCLOSED.finditer(data):
        at = match.start()
        opcode, length = struct.unpack("<BQ", data[at : at + 9])
        try:
            found.append(read_passing_enclosed(opcode, data[at + 9 : at + 9 + length]))
        except PARSE_ERRORS:
            broken += 1
    return found, broken


def _chunks(data: mmap.mmap) -> Iterator[int]:
    match = _CHUNK.search(data, 0)
    while match:
        yield match.start()
        match = _CHUNK.search(data, match.start() + _HEAD)


def _messages(data: mmap.mmap, at: int, channels: dict[int, LogChannel]) -> list[LogMessage] | None:
    _, _, _, _, size, crc, _, _, length = struct.unpack("<BQQQQII4sQ", data[at : at + _HEAD])
    try:
        plain = decompress("zstd", data[at + _HEAD : at + _HEAD + length], size)
        return list(passing_messages(plain, channels)) if zlib.crc32(plain) == crc else None
    except PARSE_ERRORS:
        return None


def _channels(data: mmap.mmap, path: Path, own: set[int]) -> dict[int, LogChannel]:
    """The channels by the index, whose CRC holds where it can be read; else by the records at the start."""
    try:
        return ArchiveReader(path).log
    except ArchiveError:
        found: dict[int, LogChannel] = {}
    for document in attachments(data, DESCRIPTION):
        with suppress(*PARSE_ERRORS):
            found |= {channel.id: channel for channel in map(channel_of_document, document["log"])}
    schemas: dict[int, Schema] = {}
    try:
        for opcode, _, content in records(data[8:_MOST]):
            if opcode == Opcode.SCHEMA:
                schema = Schema.read(stream(content))
                schemas[schema.id] = schema
            elif opcode == Opcode.CHANNEL and (channel := Channel.read(stream(content))).id not in own:
                passing = passing_channel(channel, schemas.get(channel.schema_id))
                found[passing.id] = passing
            elif opcode == Opcode.CHUNK:
                break
    except PARSE_ERRORS:
        pass
    return found
