"""Read an archive. It is not trusted: every length is checked against the file, every CRC is verified."""

from __future__ import annotations

import json
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    Footer,
    Message,
    MessageIndex,
    Metadata,
    MetadataIndex,
    Schema,
)

from salpcc.schemas.errors import ArchiveError, SalpccError
from salpcc.schemas.file_kind import kind_of
from salpcc.schemas.files import location, read_at, reading, why
from salpcc.schemas.log import Enclosed, LogChannel, LogMessage
from salpcc.schemas.mcap_chunks import PARSE_ERRORS, read_chunk, records, stream
from salpcc.schemas.messages import CloudMessage
from salpcc.schemas.work import Movable
from salpcc.stages.lattice.sensor_model import SensorModel
from salpcc.stages.residual_code.archive.format import (
    MAGIC,
    SECOND_VERSION,
    ArchiveFacts,
    ScanEntry,
    ScanPayload,
    entry_of,
    file_name,
    read_own_channels,
)
from salpcc.stages.residual_code.archive.passing import (
    ENCLOSED,
    passing_channel,
    passing_messages,
    read_passing_enclosed,
)
from salpcc.stages.residual_code.archive.side_files import SIDE, SideFile, side_file, side_name

_FOOTER_BYTES = 9 + 20


class ArchiveReader:
    """The index of an archive in memory; payloads are read chunk by chunk when asked for.

    No file stays open, so a reader can be pickled and forked.

    Attributes:
        path: the file, or its URL.
        facts: sequence, source, inputs, configuration and sensor model.
        gops: the entries of the scans (of their static layers), by GOP number; a GOP all of whose scans failed is empty.
        movable_gops: the entries of their movable layers, where the archive holds them, of the first scans of each GOP.
        log: channels of the log that the scans were in; empty for scans that were files.
        side: bytes that the side files take in the archive, by name.
    """

    def __init__(self, path: str | Path) -> None:
        """Open ``path`` and read its index.

        Raises:
            ArchiveError: not an archive of this tool, damaged, truncated, or of a newer major version.
        """
        self.path = location(path)
        try:
            self.size = self.path.stat().st_size
            self._read_index()
        except OSError as error:
            raise ArchiveError(f"{self.path}: {why(error)}") from error
        except PARSE_ERRORS as error:
            raise ArchiveError(f"{self.path}: the index is damaged ({error})") from error

    @property
    def movable(self) -> Movable:
        """What became of what may move."""
        if self.facts.layers:
            return "layered" if any(self.movable_gops) else "dropped"
        config = self.facts.config
        kept = config.get(
            "keep_movable", not any(entry.dropped_movable for gop in self.gops for entry in gop)
        )
        return "one layer" if kept else "dropped"

    @property
    def entries(self) -> list[tuple[ScanEntry, ...]]:
        """The entries of the scans by GOP, both layers of a scan together where the archive holds them."""
        return [
            (
                *(entry.with_layer(movable) for entry, movable in zip(gop, layer, strict=False)),
                *gop[len(layer) :],
            )
            for gop, layer in zip(self.gops, self.movable_gops, strict=True)
        ]

    def payloads(self, gop: int) -> list[ScanPayload]:
        """Read the coded scans of one GOP; of a layered archive their static layers, and no byte of the others.

        Raises:
            ArchiveError: the chunk is damaged, or does not hold the scans that the index lists.
        """
        return self._payloads(f"GOP {gop}", self.gops[gop], self._chunks.get(gop))

    def movable_payloads(self, gop: int) -> list[ScanPayload]:
        """Read the movable layers of one GOP, those of its first scans where later ones were lost.

        Raises:
            ArchiveError: as for :meth:`payloads`.
        """
        return self._payloads(
            f"movable layer of GOP {gop}", self.movable_gops[gop], self._movable_chunks.get(gop)
        )

    def times(self, gop: int) -> list[int]:
        """Read the time stamps (ns) of the scans of one GOP, and none of the scans.

        Raises:
            ArchiveError: they are damaged.
        """
        if not self.gops[gop]:
            return []
        try:
            at = self._chunks[gop].message_index_offsets[1]
            index = MessageIndex.read(self._record(at, Opcode.MESSAGE_INDEX))
        except PARSE_ERRORS as error:
            raise ArchiveError(f"{self.path}: index of GOP {gop} is damaged ({error})") from error
        if len(index.records) != len(self.gops[gop]):
            raise ArchiveError(f"{self.path}: index of GOP {gop} lists {len(index.records)} scans")
        return [time for time, _ in index.records]

    def layer_chunks(self) -> list[tuple[str, int, ChunkIndex]]:
        """Return layer (``static`` or ``movable``), GOP and index of every chunk of coded scans, in the order of the file."""
        found = [("static", gop, chunk) for gop, chunk in self._chunks.items()]
        found += [("movable", gop, chunk) for gop, chunk in self._movable_chunks.items()]
        return sorted(found, key=lambda row: row[2].chunk_start_offset)

    def chunk_bytes(self, chunk: ChunkIndex) -> bytes:
        """Return the bytes of a chunk's record, as they lie in the file."""
        return self._bytes(chunk.chunk_start_offset, chunk.chunk_length)

    def _payloads(
        self, what: str, entries: tuple[ScanEntry, ...], at: ChunkIndex | None
    ) -> list[ScanPayload]:
        if not entries or at is None:
            return []
        where = f"{self.path}: {what} (scans {entries[0].name} to {entries[-1].name})"
        try:
            chunk = Chunk.read(self._record(at.chunk_start_offset, Opcode.CHUNK))
            if chunk.compression or zlib.crc32(chunk.data) != chunk.uncompressed_crc:
                raise ArchiveError(f"{where}: CRC mismatch, the file is damaged")
            found = [content for opcode, _, content in records(chunk.data) if opcode == Opcode.MESSAGE]
            messages = [Message.read(stream(content), len(content)) for content in found]
            clouds = [CloudMessage.from_cdr(message.data, compressed=True) for message in messages]
        except PARSE_ERRORS as error:
            raise ArchiveError(f"{where}: damaged ({error})") from error
        of_labels = [message.channel_id in self._label_channels for message in messages]
        scans = [place for place, behind in enumerate(of_labels) if not behind]
        if len(scans) != len(entries):
            raise ArchiveError(f"{where}: {len(scans)} messages for {len(entries)} scans")
        payloads = []
        for entry, place in zip(entries, scans, strict=True):
            labels = clouds[place + 1].data if any(of_labels[place + 1 : place + 2]) else b""
            if len(labels) != entry.labels:
                raise ArchiveError(f"{where}: {len(labels)} bytes of labels, the index says {entry.labels}")
            cloud = clouds[place]
            payloads.append(
                ScanPayload(entry, messages[place].log_time, cloud.frame_id, cloud.data, labels=labels)
            )
        return payloads

    def side_file(self, name: str) -> SideFile:
        """Read a side file.

        Raises:
            KeyError: there is none of that name.
            ArchiveError: it is damaged.
        """
        at = self._side[name]
        try:
            return side_file(Attachment.read(stream(self._attachment_bytes(at))))
        except PARSE_ERRORS as error:
            raise ArchiveError(f"{self.path}: {error}") from error

    def passing(self) -> Iterator[LogMessage]:
        """Yield the messages that passed through, in the order of the file.

        Raises:
            ArchiveError: a chunk of them is damaged.
        """
        for chunk in self._passing:
            try:
                with reading(self.path) as file:
                    data = read_chunk(file, chunk.chunk_start_offset + 9, chunk.chunk_length - 9)
                yield from passing_messages(data, self.log)
            except PARSE_ERRORS as error:
                raise ArchiveError(f"{self.path}: chunk at {chunk.chunk_start_offset}: {error}") from error

    def enclosed(self) -> Iterator[Enclosed]:
        """Yield the attachments and metadata of the log, in its order.

        Raises:
            ArchiveError: one of them is damaged.
        """
        for at in self._enclosed:
            opcode = Opcode.METADATA if isinstance(at, MetadataIndex) else Opcode.ATTACHMENT
            try:
                yield read_passing_enclosed(opcode, self._record_bytes(at.offset, opcode))
            except PARSE_ERRORS as error:
                raise ArchiveError(f"{self.path}: {at.name}: {error}") from error

    @property
    def has_classes(self) -> bool:
        """Whether classes of the points are stored; one that keeps all points without being given labels has none."""
        return any(entry.classes for gop in self.gops for entry in gop)

    @property
    def has_labels(self) -> bool:
        """Whether labels of the points are stored, as annotators left them."""
        return any(entry.labels for gop in self.gops for entry in gop)

    @property
    def labels_bytes(self) -> int:
        """Bytes of the coded labels of all layers."""
        return sum(entry.labels for gops in (self.gops, self.movable_gops) for gop in gops for entry in gop)

    @property
    def span(self) -> tuple[int, int]:
        """Time stamps of the first and the last scan, ns; zeros where there are none."""
        chunks = self._chunks.values()
        first = min((chunk.message_start_time for chunk in chunks), default=0)
        return first, max((chunk.message_end_time for chunk in chunks), default=0)

    @property
    def passing_bytes(self) -> int:
        """Bytes of the file that hold what passed through."""
        chunks = sum(chunk.chunk_length + chunk.message_index_length for chunk in self._passing)
        return chunks + sum(at.length for at in self._enclosed)

    @property
    def container_bytes(self) -> int:
        """Bytes of the file that are neither payload nor passing: index, sensor model, configuration, framing."""
        coded = (entry.bytes for gops in (self.gops, self.movable_gops) for gop in gops for entry in gop)
        beside = self.passing_bytes + self.labels_bytes + sum(self.side.values())
        return self.size - sum(coded) - beside

    def check(self) -> None:
        """Verify the CRC over everything before the summary (the summary's own was checked on opening).

        Raises:
            ArchiveError: a byte differs from what was written.
        """
        crc = 0
        left = self._data_end
        with reading(self.path) as file:
            while left > 0:
                block = file.read(min(left, 1 << 20))
                if not block:
                    raise ArchiveError(f"{self.path}: ends early")
                crc = zlib.crc32(block, crc)
                left -= len(block)
        # The record has no checksum of its own, so all of it is compared.
        if self._bytes(self._data_end, 13) != struct.pack("<BQI", Opcode.DATA_END, 4, crc):
            raise ArchiveError(f"{self.path}: CRC of the data section does not match, the file is damaged")

    @property
    def _no_archive(self) -> str:
        return (
            f"{self.path}: an MCAP file, but not an archive of salpcc-pipeline; "
            "`salpcc-pipeline run log` makes one of a log"
        )

    def _read_index(self) -> None:
        head, tail = self._bytes(0, len(MAGIC)), self._bytes(self.size - len(MAGIC), len(MAGIC))
        if head != MAGIC:
            raise ArchiveError(
                f"{self.path}: {kind_of(self.path)}, not an archive of salpcc-pipeline (those are OUT/archives/SEQ.mcap)"
            )
        if tail != MAGIC:
            raise ArchiveError(f"{self.path}: truncated, the end of the file is missing")
        footer_at = self.size - len(MAGIC) - _FOOTER_BYTES
        footer = Footer.read(self._record(footer_at, Opcode.FOOTER))
        summary = self._bytes(footer.summary_start, footer_at - footer.summary_start)
        covered = self._bytes(footer_at, _FOOTER_BYTES - 4)
        if zlib.crc32(covered, zlib.crc32(summary)) != footer.summary_crc:
            if footer.summary_crc == 0:  # ours have one
                raise ArchiveError(self._no_archive)
            raise ArchiveError(f"{self.path}: CRC of the summary does not match, the file is damaged")
        chunks: list[ChunkIndex] = []
        attachments: dict[str, AttachmentIndex] = {}
        metadata: dict[str, MetadataIndex] = {}
        enclosed: list[AttachmentIndex | MetadataIndex] = []
        schemas: dict[int, Schema] = {}
        channels: list[Channel] = []
        self.log: dict[int, LogChannel] = {}
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
            raise ArchiveError(self._no_archive)
        self._side = {
            side_name(name): attachment for name, attachment in attachments.items() if name.startswith(SIDE)
        }
        self.side = {name: at.length for name, at in self._side.items()}
        of_log = (at for at in enclosed if at.name.startswith(ENCLOSED))
        self._enclosed = sorted(of_log, key=lambda at: at.offset)
        self._data_end = footer.summary_start - 9 - 4
        self.facts, own = self._facts(metadata["salpcc"], attachments)
        movable = own.get("movable")
        self._label_channels = {number for name, number in own.items() if name != "movable"}
        for channel in channels:
            if channel.id not in (1, *own.values()):
                passing = passing_channel(channel, schemas.get(channel.schema_id))
                self.log[passing.id] = passing
        index = json.loads(self._attachment(attachments["index.json"]))
        self.gops = [tuple(entry_of(row) for row in gop) for gop in index]
        layer: list[Any] = [[] for _ in self.gops]
        if "movable.json" in attachments and self.facts.layers:
            layer = json.loads(self._attachment(attachments["movable.json"]))
        self.movable_gops = [tuple(entry_of(row) for row in gop) for gop in layer]
        pairs = zip(self.gops, self.movable_gops, strict=True)
        if any(
            [e.name for e in movable_gop] != [e.name for e in gop][: len(movable_gop)]
            for gop, movable_gop in pairs
        ):
            raise ArchiveError(f"{self.path}: the movable layer is of other scans")
        chunks.sort(key=lambda chunk: chunk.chunk_start_offset)
        self._passing = [chunk for chunk in chunks if chunk.compression]
        chunks = [chunk for chunk in chunks if not chunk.compression]
        of_movable = [chunk for chunk in chunks if movable in chunk.message_index_offsets]
        self._movable_chunks = self._by_gop(self.movable_gops, of_movable)
        self._chunks = self._by_gop(self.gops, [chunk for chunk in chunks if chunk not in of_movable])

    def _by_gop(self, gops: list[tuple[ScanEntry, ...]], chunks: list[ChunkIndex]) -> dict[int, ChunkIndex]:
        """Say of which GOP each chunk of a layer is."""
        full = [number for number, gop in enumerate(gops) if gop]
        if len(full) != len(chunks):
            raise ArchiveError(f"{self.path}: {len(chunks)} chunks for {len(full)} GOPs")
        return dict(zip(full, chunks, strict=True))

    def _facts(
        self, at: MetadataIndex, attachments: dict[str, AttachmentIndex]
    ) -> tuple[ArchiveFacts, dict[str, int]]:
        """The facts, and the ids of the channels that are the archive's own."""
        about = Metadata.read(self._record(at.offset, Opcode.METADATA)).metadata
        version = about["archive_version"]
        if int(version.split(".")[0]) > int(SECOND_VERSION.split(".")[0]):
            raise ArchiveError(
                f"{self.path}: archive version {version} is newer than this tool reads ({SECOND_VERSION}); update it"
            )
        own = read_own_channels(about)
        try:
            sensor = SensorModel.from_json(self._attachment(attachments["sensor.json"]).decode())
        except SalpccError as error:
            raise ArchiveError(f"{self.path}: {error}") from error
        config: dict[str, Any] = dict(json.loads(self._attachment(attachments["config.json"])))
        sequence = file_name(about["sequence"])
        about_it = sequence, about["source"], about["inputs"], config, sensor
        return ArchiveFacts(*about_it, layers="movable" in own, labels="labels" in own), own

    def _attachment(self, at: AttachmentIndex) -> bytes:
        return bytes(Attachment.read(stream(self._attachment_bytes(at))).data)

    def _attachment_bytes(self, at: AttachmentIndex) -> bytes:
        raw = self._record_bytes(at.offset, Opcode.ATTACHMENT)
        if zlib.crc32(raw[:-4]) != struct.unpack("<I", raw[-4:])[0]:
            raise ArchiveError(f"{self.path}: CRC of {at.name} does not match, the file is damaged")
        return raw

    def _record(self, at: int, opcode: Opcode) -> ReadDataStream:
        return stream(self._record_bytes(at, opcode))

    def _record_bytes(self, at: int, opcode: Opcode) -> bytes:
        found, length = struct.unpack("<BQ", self._bytes(at, 9))
        if found != opcode:
            raise ArchiveError(f"{self.path}: byte {at} should start a record {opcode}, holds {found}")
        return self._bytes(at + 9, length)

    def _bytes(self, at: int, length: int) -> bytes:
        if at < 0 or length < 0 or at + length > self.size:
            raise ArchiveError(
                f"{self.path}: truncated or damaged, wants bytes {at} to {at + length} of {self.size}"
            )
        return read_at(self.path, at, length)
