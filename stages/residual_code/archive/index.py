"""The index of an archive: what is in it, and at which byte."""

from __future__ import annotations

import json
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mcap.opcode import Opcode
from mcap.records import AttachmentIndex, Channel, ChunkIndex, Footer, Metadata, MetadataIndex, Schema

from salpcc.schemas.errors import ArchiveError, DamagedError, SalpccError
from salpcc.schemas.file_kind import kind_of
from salpcc.schemas.log import LogChannel
from salpcc.schemas.mcap_chunks import records, stream
from salpcc.stages.lattice.sensor_model import SensorModel
from salpcc.stages.residual_code.archive.documents import unpack_document
from salpcc.stages.residual_code.archive.format import (
    DESCRIPTION,
    INDEX,
    MAGIC,
    ArchiveFacts,
    ScanEntry,
    check_version,
    entry_of,
    file_name,
    read_own_channels,
)
from salpcc.stages.residual_code.archive.passing import ENCLOSED, channel_of_document, passing_channel
from salpcc.stages.residual_code.archive.record_file import RecordFile
from salpcc.stages.residual_code.archive.side_files import SIDE, side_name

_FOOTER_BYTES = 9 + 20

Gops = list[tuple[ScanEntry, ...]]


@dataclass(frozen=True, eq=False)
class ArchiveIndex:
    """What the summary of an archive tells.

    Attributes:
        facts: sequence, source, inputs, configuration and sensor model.
        gops, movable_gops: entries of the scans (of their static layers) and of their movable layers, by GOP.
        chunks, movable_chunks: where the coded scans of each layer lie, by GOP.
        label_channels: channels of the labels.
        log: channels of the log that the scans were in, by number.
        passing: chunks of its messages, in the order of the file.
        enclosed: its attachments and metadata.
        side: side files by name.
        data_end: the byte at which the data section ends.
    """

    facts: ArchiveFacts
    gops: Gops
    movable_gops: Gops
    chunks: dict[int, ChunkIndex]
    movable_chunks: dict[int, ChunkIndex]
    label_channels: set[int]
    log: dict[int, LogChannel]
    passing: list[ChunkIndex]
    enclosed: list[AttachmentIndex | MetadataIndex]
    side: dict[str, AttachmentIndex]
    data_end: int


def read_index(file: RecordFile) -> ArchiveIndex:
    """Read the index of an archive.

    Raises:
        ArchiveError: not an archive of this tool, damaged, truncated, or of a newer major version.
        PARSE_ERRORS: of :mod:`salpcc.schemas.mcap_chunks`: a record is damaged.
    """
    summary, data_end = _summary(file)
    chunks: list[ChunkIndex] = []
    attachments: dict[str, AttachmentIndex] = {}
    metadata: dict[str, MetadataIndex] = {}
    enclosed: list[AttachmentIndex | MetadataIndex] = []  # a log may hold several of one name
    schemas: dict[int, Schema] = {}
    channels: list[Channel] = []
    for opcode, _, content in records(summary):
        record = stream(content)
        if opcode == Opcode.CHUNK_INDEX:
            chunks.append(ChunkIndex.read(record))
        elif opcode == Opcode.ATTACHMENT_INDEX:
            attachment = AttachmentIndex.read(record)
            attachments[attachment.name] = attachment
            enclosed.append(attachment)
        elif opcode == Opcode.METADATA_INDEX:
            entry = MetadataIndex.read(record)
            metadata[entry.name] = entry
            enclosed.append(entry)
        elif opcode == Opcode.SCHEMA:
            schema = Schema.read(record)
            schemas[schema.id] = schema
        elif opcode == Opcode.CHANNEL:
            channels.append(Channel.read(record))
    if "salpcc" not in metadata:
        raise ArchiveError(_no_archive(file.path))
    facts, own, silent = _facts(file, metadata["salpcc"], attachments)
    gops, movable_gops = _entries(file, attachments, facts)
    chunks.sort(key=lambda chunk: chunk.chunk_start_offset)
    coded = [chunk for chunk in chunks if not chunk.compression]
    of_movable = [chunk for chunk in coded if own.get("movable") in chunk.message_index_offsets]
    found = [
        passing_channel(channel, schemas.get(channel.schema_id))
        for channel in channels
        if channel.id not in (1, *own.values())
    ]
    of_log = (at for at in enclosed if at.name.startswith(ENCLOSED))
    return ArchiveIndex(
        facts,
        gops,
        movable_gops,
        _by_gop(file.path, gops, [chunk for chunk in coded if chunk not in of_movable]),
        _by_gop(file.path, movable_gops, of_movable),
        {number for name, number in own.items() if name != "movable"},
        {channel.id: channel for channel in sorted([*found, *silent], key=lambda channel: channel.id)},
        [chunk for chunk in chunks if chunk.compression],
        sorted(of_log, key=lambda at: at.offset),
        {side_name(name): at for name, at in attachments.items() if name.startswith(SIDE)},
        data_end,
    )


def _no_archive(path: Path) -> str:
    return (
        f"{path}: an MCAP file, but not an archive of salpcc-pipeline; "
        "`salpcc-pipeline run log` makes one of a log"
    )


def _summary(file: RecordFile) -> tuple[bytes, int]:
    """The summary section, its CRC checked, and the byte at which the data section ends."""
    short = min(len(MAGIC), file.size)
    head, tail = file.bytes_at(0, short), file.bytes_at(file.size - short, short)
    if head != MAGIC:
        raise ArchiveError(
            f"{file.path}: {kind_of(file.path)}, not an archive of salpcc-pipeline (those are OUT/archives/SEQ.mcap)"
        )
    if tail != MAGIC:
        raise DamagedError(f"{file.path}: truncated, the end of the file is missing")
    footer_at = file.size - len(MAGIC) - _FOOTER_BYTES
    footer = Footer.read(file.record(footer_at, Opcode.FOOTER))
    summary = file.bytes_at(footer.summary_start, footer_at - footer.summary_start)
    covered = file.bytes_at(footer_at, _FOOTER_BYTES - 4)
    if zlib.crc32(covered, zlib.crc32(summary)) != footer.summary_crc:
        if footer.summary_crc == 0:  # ours have one
            raise ArchiveError(_no_archive(file.path))
        raise DamagedError(f"{file.path}: CRC of the summary does not match, the file is damaged")
    return summary, footer.summary_start - 9 - 4


def _facts(
    file: RecordFile, at: MetadataIndex, attachments: dict[str, AttachmentIndex]
) -> tuple[ArchiveFacts, dict[str, int], list[LogChannel]]:
    """The facts, the ids of the channels that are the archive's own, and those of the log that held clouds."""
    about = Metadata.read(file.record(at.offset, Opcode.METADATA)).metadata
    try:
        check_version(about["archive_version"])
        own = read_own_channels(about)
        said = unpack_document(bytes(file.attachment(attachments[DESCRIPTION]).data))
        sensor = SensorModel.from_json(json.dumps(said["sensor"]))
    except SalpccError as error:
        raise ArchiveError(f"{file.path}: {error}") from error
    of_clouds = [channel_of_document(channel) for channel in said["log"]]
    about_it = file_name(about["sequence"]), str(said["source"]), str(said["inputs"]), dict(said["config"])
    return ArchiveFacts(*about_it, sensor, layers="movable" in own, labels="labels" in own), own, of_clouds


def _entries(
    file: RecordFile, attachments: dict[str, AttachmentIndex], facts: ArchiveFacts
) -> tuple[Gops, Gops]:
    """The entries of both layers by GOP; those of the movable one are of the first scans of each GOP."""
    index = unpack_document(bytes(file.attachment(attachments[INDEX]).data))
    gops = entries_of(index["scans"])
    layer = index.get("movable") if facts.layers else None
    movable_gops = entries_of([[]] * len(gops) if layer is None else layer)
    if any(
        [e.name for e in movable_gop] != [e.name for e in gop][: len(movable_gop)]
        for gop, movable_gop in zip(gops, movable_gops, strict=True)
    ):
        raise DamagedError(f"{file.path}: the movable layer is of other scans")
    return gops, movable_gops


def entries_of(rows: Any) -> Gops:
    """Read a layer of an index, which nobody vouches for."""
    return [tuple(entry_of(row) for row in gop) for gop in rows]


def _by_gop(path: Path, gops: Gops, chunks: list[ChunkIndex]) -> dict[int, ChunkIndex]:
    """Say of which GOP each chunk of a layer is."""
    full = [number for number, gop in enumerate(gops) if gop]
    if len(full) != len(chunks):
        raise DamagedError(f"{path}: {len(chunks)} chunks for {len(full)} GOPs")
    return dict(zip(full, chunks, strict=True))
