"""Read an archive. It is not trusted: every length is checked against the file, every CRC is verified."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from pathlib import Path

from mcap.opcode import Opcode
from mcap.records import (
    Chunk,
    ChunkIndex,
    Message,
    MessageIndex,
    MetadataIndex,
)

from salpcc.schemas.errors import ArchiveError, DamagedError
from salpcc.schemas.files import location, reading, why
from salpcc.schemas.log import Enclosed, LogMessage
from salpcc.schemas.mcap_chunks import PARSE_ERRORS, read_chunk, records, stream
from salpcc.schemas.messages import CloudMessage
from salpcc.schemas.work import Movable
from salpcc.stages.residual_code.archive.format import ScanEntry, ScanPayload
from salpcc.stages.residual_code.archive.index import read_index
from salpcc.stages.residual_code.archive.passing import passing_messages, read_passing_enclosed
from salpcc.stages.residual_code.archive.record_file import RecordFile
from salpcc.stages.residual_code.archive.side_files import SideFile, side_file


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
            self._file = RecordFile(self.path)
            self._index = read_index(self._file)
        except OSError as error:
            raise ArchiveError(f"{self.path}: {why(error)}") from error
        except PARSE_ERRORS as error:
            raise DamagedError(f"{self.path}: the index is damaged ({error})") from error
        self.size = self._file.size
        self.facts = self._index.facts
        self.gops, self.movable_gops = self._index.gops, self._index.movable_gops
        self.log = self._index.log
        self.side = {name: at.length for name, at in self._index.side.items()}

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
    def names(self) -> list[str]:
        """Names of the scans, in the order of the archive."""
        return [entry.name for gop in self.gops for entry in gop]

    @property
    def held(self) -> str:
        """Say which scans there are, for messages."""
        names = self.names
        return f"it holds {names[0]} to {names[-1]}" if names else "it holds none"

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
        return self._payloads(f"GOP {gop}", self.gops[gop], self._index.chunks.get(gop))

    def movable_payloads(self, gop: int) -> list[ScanPayload]:
        """Read the movable layers of one GOP, those of its first scans where later ones were lost.

        Raises:
            ArchiveError: as for :meth:`payloads`.
        """
        return self._payloads(
            f"movable layer of GOP {gop}", self.movable_gops[gop], self._index.movable_chunks.get(gop)
        )

    def times(self, gop: int) -> list[int]:
        """Read the time stamps (ns) of the scans of one GOP, and none of the scans.

        Raises:
            ArchiveError: they are damaged.
        """
        if not self.gops[gop]:
            return []
        try:
            at = self._index.chunks[gop].message_index_offsets[1]
            index = MessageIndex.read(self._file.record(at, Opcode.MESSAGE_INDEX))
        except PARSE_ERRORS as error:
            raise DamagedError(f"{self.path}: index of GOP {gop} is damaged ({error})") from error
        if len(index.records) != len(self.gops[gop]):
            raise DamagedError(f"{self.path}: index of GOP {gop} lists {len(index.records)} scans")
        return [time for time, _ in index.records]

    def layer_chunks(self) -> list[tuple[str, int, ChunkIndex]]:
        """Return layer (``static`` or ``movable``), GOP and index of every chunk of coded scans, in the order of the file."""
        found = [("static", gop, chunk) for gop, chunk in self._index.chunks.items()]
        found += [("movable", gop, chunk) for gop, chunk in self._index.movable_chunks.items()]
        return sorted(found, key=lambda row: row[2].chunk_start_offset)

    def chunk_bytes(self, chunk: ChunkIndex) -> bytes:
        """Return the bytes of a chunk's record, as they lie in the file."""
        return self._file.bytes_at(chunk.chunk_start_offset, chunk.chunk_length)

    def _payloads(
        self, what: str, entries: tuple[ScanEntry, ...], at: ChunkIndex | None
    ) -> list[ScanPayload]:
        if not entries or at is None:
            return []
        where = f"{self.path}: {what} (scans {entries[0].name} to {entries[-1].name})"
        try:
            chunk = Chunk.read(self._file.record(at.chunk_start_offset, Opcode.CHUNK))
            if chunk.compression or zlib.crc32(chunk.data) != chunk.uncompressed_crc:
                raise DamagedError(f"{where}: CRC mismatch, the file is damaged")
            found = [content for opcode, _, content in records(chunk.data) if opcode == Opcode.MESSAGE]
            messages = [Message.read(stream(content), len(content)) for content in found]
            clouds = [CloudMessage.from_cdr(message.data, compressed=True) for message in messages]
        except PARSE_ERRORS as error:
            raise DamagedError(f"{where}: damaged ({error})") from error
        of_labels = [message.channel_id in self._index.label_channels for message in messages]
        scans = [place for place, behind in enumerate(of_labels) if not behind]
        if len(scans) != len(entries):
            raise DamagedError(f"{where}: {len(scans)} messages for {len(entries)} scans")
        payloads = []
        for entry, place in zip(entries, scans, strict=True):
            labels = clouds[place + 1].data if any(of_labels[place + 1 : place + 2]) else b""
            if len(labels) != entry.labels:
                raise DamagedError(f"{where}: {len(labels)} bytes of labels, the index says {entry.labels}")
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
        at = self._index.side[name]
        try:
            return side_file(self._file.attachment(at))
        except PARSE_ERRORS as error:
            raise DamagedError(f"{self.path}: side file {name}: {error}") from error

    @property
    def passing_topics(self) -> list[str]:
        """Topics of the messages that passed through, sorted; no message is read."""
        numbers = {number for chunk in self._index.passing for number in chunk.message_index_offsets}
        return sorted({self.log[number - 1].topic for number in numbers})

    def passing(self) -> Iterator[LogMessage]:
        """Yield the messages that passed through, in the order of the file.

        Raises:
            ArchiveError: a chunk of them is damaged.
        """
        for chunk in self._index.passing:
            try:
                with reading(self.path) as file:
                    data = read_chunk(file, chunk.chunk_start_offset + 9, chunk.chunk_length - 9)
                yield from passing_messages(data, self.log)
            except PARSE_ERRORS as error:
                raise DamagedError(f"{self.path}: chunk at {chunk.chunk_start_offset}: {error}") from error

    def enclosed(self) -> Iterator[Enclosed]:
        """Yield the attachments and metadata of the log, in its order.

        Raises:
            ArchiveError: one of them is damaged.
        """
        for at in self._index.enclosed:
            opcode = Opcode.METADATA if isinstance(at, MetadataIndex) else Opcode.ATTACHMENT
            try:
                yield read_passing_enclosed(opcode, self._file.content(at.offset, opcode))
            except PARSE_ERRORS as error:
                raise DamagedError(f"{self.path}: {at.name}: {error}") from error

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
        chunks = self._index.chunks.values()
        first = min((chunk.message_start_time for chunk in chunks), default=0)
        return first, max((chunk.message_end_time for chunk in chunks), default=0)

    @property
    def passing_span(self) -> tuple[int, int]:
        """When the first and the last message that passed through were recorded, ns; the last before the first where none did."""
        first = min((chunk.message_start_time for chunk in self._index.passing), default=0)
        return first, max((chunk.message_end_time for chunk in self._index.passing), default=-1)

    @property
    def passing_bytes(self) -> int:
        """Bytes of the file that hold what passed through."""
        chunks = sum(chunk.chunk_length + chunk.message_index_length for chunk in self._index.passing)
        return chunks + sum(at.length for at in self._index.enclosed)

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
        left = self._index.data_end
        with reading(self.path) as file:
            while left > 0:
                block = file.read(min(left, 1 << 20))
                if not block:
                    raise DamagedError(f"{self.path}: ends early")
                crc = zlib.crc32(block, crc)
                left -= len(block)
        # The record has no checksum of its own, so all of it is compared.
        if self._file.bytes_at(self._index.data_end, 13) != struct.pack("<BQI", Opcode.DATA_END, 4, crc):
            raise DamagedError(f"{self.path}: CRC of the data section does not match, the file is damaged")
