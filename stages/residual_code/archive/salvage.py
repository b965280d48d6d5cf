"""See a damaged archive without its index: the scans that are whole, and the names of those that are not."""

from __future__ import annotations

import json
import re
import struct
from collections import Counter
from contextlib import suppress
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import Any

from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.opcode import Opcode
from mcap.records import AttachmentIndex, ChunkIndex, Metadata, MetadataIndex

from salpcc.schemas.errors import ArchiveError
from salpcc.schemas.file_kind import kind_of
from salpcc.schemas.files import location, mapped, why
from salpcc.schemas.mcap_chunks import records, stream
from salpcc.schemas.passing_log import PassingLog
from salpcc.schemas.work import Movable
from salpcc.stages.lattice.sensor_model import SENSORS, SensorModel, load_sensor
from salpcc.stages.residual_code.archive.documents import MARK
from salpcc.stages.residual_code.archive.format import (
    ARCHIVE_VERSION,
    DESCRIPTION,
    DIGITS,
    INDEX,
    OWN_TOPICS,
    ArchiveFacts,
    ScanEntry,
    ScanPayload,
    check_version,
    file_name,
    read_own_channels,
    sequence_number,
)
from salpcc.stages.residual_code.archive.fragments import (
    BROKEN,
    RECORD_HEAD,
    Place,
    attachments,
    chunks,
    clouds,
    gop_records,
)
from salpcc.stages.residual_code.archive.index import entries_of
from salpcc.stages.residual_code.archive.passing_salvage import passing_log
from salpcc.stages.residual_code.archive.side_files import SideFile
from salpcc.stages.residual_code.archive.side_salvage import side_files
from salpcc.stages.residual_code.archive.writer import labels_message, message_of
from salpcc.stages.residual_code.label_coder import check_labels
from salpcc.stages.residual_code.paper import grid_payload
from salpcc.stages.residual_code.paper.grid_header import GRID_CODEC
from salpcc.stages.residual_code.sensor import payload

# At least one of them is in whatever part of an archive holds a scan.
_TRACES = (MARK, b"salpcc/")
# DataEnd, its CRC, and the first schema of the summary.
_DATA_END = re.compile(rb"\x0f\x04\0{7}.{4}\x03", re.DOTALL)
_LEAST_GOP = 100  # bytes; so many GOPs at most lie before a byte, whatever a record claims


class Salvage:
    """A damaged archive; stands in for an ``ArchiveReader`` where scans are decoded.

    Attributes:
        facts: as of a reader; ``inputs`` is empty, for nothing says that it is right.
        gops: the scans that were found, by GOP number: all of a GOP, its first ones, or none.
        names: the scans that each GOP was written with; None where nobody knows.
        notes: what is gone besides scans, one line each.
        all_known: whether it is certain that ``names`` lists all there was.
        ended: whether the file goes on to the end of its data: side files and what the log enclosed stand there, and
            nothing else says how many there were.
    """

    def __init__(self, path: str | Path, sensor: SensorModel | None = None) -> None:
        """Search ``path``; ``sensor`` stands in for a sensor model that is gone.

        Raises:
            ArchiveError: unreadable, no archive, or its sensor model is gone.
        """
        self.path = location(path)
        self.notes: list[str] = []
        kind = kind_of(self.path)
        if kind == "an empty file":
            raise ArchiveError(f"{self.path}: {kind}, nothing of an archive is in it")
        try:
            self._data = mapped(self.path)
        except (OSError, ValueError) as error:
            raise ArchiveError(f"{self.path}: {why(error)}") from error
        if kind == "a text file" or all(self._data.find(name) < 0 for name in _TRACES):
            raise ArchiveError(
                f"{self.path}: {kind}, and nothing in it is of an archive of salpcc-pipeline "
                "(`mcap recover` mends a log, `salpcc-pipeline run log` archives it)"
            )
        end = _DATA_END.search(self._data)
        self.ended = end is not None
        self._listed = _listed(self._data[end.end() - 1 :]) if end else Counter()
        self.facts = self._facts(sensor)
        self._index, layer = self._read_index("scans"), self._read_index("movable")
        self._rows = {entry.name: entry for gop in self._index or [] for entry in gop}
        self._movable_rows = {entry.name: entry for gop in layer or [] for entry in gop}
        self._place_gops()
        said = Counter(c.frame_id for place in self._places.values() for _, c in clouds(self._data, place))
        self._frame_ids = {frame_id for frame_id, times in said.items() if times > 1}
        self.gops = [tuple(p.entry for p in self.payloads(number)) for number in range(len(self.names))]

    @property
    def movable(self) -> Movable:
        """As of a reader, as far as it can be known; scans whose movable layer is gone are still of two layers."""
        return "layered" if self.facts.layers and self._movable_places else "dropped"

    def payloads(self, gop: int) -> list[ScanPayload]:
        """Return the scans of a GOP (their static layers) up to the first that is damaged."""
        return self._payloads(gop, self._places.get(gop), 1, self._own.get("labels"), self._rows)

    def movable_payloads(self, gop: int) -> list[ScanPayload]:
        """Return the movable layers of a GOP up to the first that is damaged."""
        channels = self._own.get("movable", 0), self._own.get("movable_labels")
        return self._payloads(gop, self._movable_places.get(gop), *channels, self._movable_rows)

    def _payloads(
        self, gop: int, place: Place | None, channel: int, labels: int | None, rows: dict[str, ScanEntry]
    ) -> list[ScanPayload]:
        found: list[ScanPayload] = []
        if place is None:
            return found
        names = iter(self.names[gop] or ())
        for (start, end), (message, cloud) in zip(place.messages, clouds(self._data, place), strict=False):
            try:
                if message.channel_id == labels and found and not found[-1].labels:
                    check_labels(cloud.data)
                    scan = _labelled(found[-1], cloud.data)
                    again = labels_message(scan, message.sequence, labels)
                else:
                    name = next(names, f"{message.sequence:06d}")
                    entry = replace(rows.get(name) or _entry(name, cloud.data), labels=0)
                    _entry(name, cloud.data)
                    scan = ScanPayload(entry, message.log_time, cloud.frame_id, cloud.data)
                    again = message_of(scan, message.sequence, self._version, channel)
            except BROKEN:
                if message.channel_id == labels:
                    continue  # the scans behind need them not
                break
            builder = RecordBuilder()
            again.write(builder)
            same = builder.end()[RECORD_HEAD:] == self._data[start:end] and cloud.frame_id in self._frame_ids
            if place.whole or same:
                found[len(found) - bool(scan.labels) :] = [scan]
            elif not scan.labels:
                break
        return found

    def had_labels(self, name: str, movable: bool) -> bool:
        """Tell whether a layer of a scan had labels, as far as it can be known."""
        row = (self._movable_rows if movable else self._rows).get(name)
        return self.facts.labels if row is None else row.labels > 0

    def side_files(self) -> tuple[list[SideFile], int]:
        """Return the side files that are whole, and how many are not."""
        found, broken = side_files(self._data)
        return found, max(broken, self._listed["side"] - len(found))

    def passing_log(self) -> tuple[PassingLog | None, int]:
        """Return what passes through, None where nothing did, and how many of its chunks are damaged."""
        listed = self._listed["zstd"] + self._listed["log"]
        return passing_log(self._data, self.path, self._own.values(), listed)

    def _facts(self, sensor: SensorModel | None) -> ArchiveFacts:
        self._version, about = ARCHIVE_VERSION, {}
        self._own: dict[str, int] = {}
        try:
            at = self._data.find(struct.pack("<I", 6) + b"salpcc")
            about = Metadata.read(
                ReadDataStream(BytesIO(self._data[max(at, 0) : max(at, 0) + 4096]))
            ).metadata
            self._version = about["archive_version"]
            self._own = read_own_channels(about)
            sequence = file_name(about["sequence"])
            check_version(self._version)
        except ArchiveError as error:
            raise ArchiveError(f"{self.path}: {error}") from error
        except BROKEN:
            sequence = self.path.stem
            self.notes.append(f"the description of the archive is gone; taken for sequence {sequence}")
        said = self._only(DESCRIPTION)
        if not isinstance(said, dict):
            self.notes.append("the configuration is gone")
            said = {}
        config = dict(said.get("config", {}))
        model = self._sensor(sensor, said.get("sensor"), about.get("sensor"))
        if not about:
            self._own = self._guessed(config)
        of_own = {"layers": "movable" in self._own, "labels": "labels" in self._own}
        return ArchiveFacts(sequence, str(said.get("source", "unknown")), "", config, model, **of_own)

    def _guessed(self, config: dict[str, Any]) -> dict[str, int]:
        """The ids of the archive's own channels where the record that tells them is gone: by their topics."""
        found = {}
        for name, topic in OWN_TOPICS.items():
            mark = struct.pack("<I", len(topic)) + topic.encode() + struct.pack("<I", 3) + b"cdr"
            at = self._data.find(mark)
            if at >= 4:
                found[name] = struct.unpack("<H", self._data[at - 4 : at - 2])[0]
        return found if found or not config.get("layers") else {"movable": 2}

    def _sensor(self, given: SensorModel | None, document: object, digest: str | None) -> SensorModel:
        if document is not None:
            return SensorModel.from_json(json.dumps(document))
        shipped = [load_sensor(path) for path in sorted(SENSORS.glob("*.json"))]
        model = next((model for model in shipped if model.digest[:DIGITS] == digest), given)
        if model is not None:
            self.notes.append(f"the sensor model is gone; {model.name} took its place")
            return model
        raise ArchiveError(f"{self.path}: the sensor model is gone; give the one that was used with --sensor")

    def _only(self, name: str) -> Any:
        return next(attachments(self._data, name), None)

    def _read_index(self, layer: str) -> list[tuple[ScanEntry, ...]] | None:
        try:
            return entries_of(self._only(INDEX)[layer])
        except BROKEN:
            return None

    def _place_gops(self) -> None:
        """Find the chunks, say which GOP each is, and which scans each GOP had."""
        records: dict[int, tuple[int, tuple[str, ...]]] = {}  # by where its chunk starts
        said: Counter[str] = Counter()
        for start, end, content in gop_records(self._data):
            try:
                number, names = int(content["gop"]), tuple(file_name(name) for name in content["scans"])
                said[str(content["sequence"])] += 1
            except BROKEN:
                continue
            if 0 <= number <= start // _LEAST_GOP:
                records[end] = number, names
        if said and said.most_common(1)[0][0] != self.facts.sequence:
            self.facts = replace(self.facts, sequence=file_name(said.most_common(1)[0][0]))
            self.notes.append(f"the description of the archive is damaged; sequence {self.facts.sequence}")
        index = dict(enumerate(tuple(entry.name for entry in gop) for gop in self._index or []))
        known = index | dict(records.values())
        flat = [(number, name) for number, names in index.items() for name in names]
        by_sequence = {sequence_number(name, place): number for place, (number, name) in enumerate(flat)}
        self._places: dict[int, Place] = {}
        self._movable_places: dict[int, Place] = {}
        last = -1
        for place in chunks(self._data, records):
            message = next((message for message, _ in clouds(self._data, place)), None)
            if message is None:
                continue
            first = message.sequence
            if message.channel_id == self._own.get(
                "movable"
            ):  # right behind the static layer, if that is there
                self._movable_places.setdefault(by_sequence.get(first, last), place)
                continue
            last = records[place.start][0] if place.start in records else by_sequence.get(first, last + 1)
            self._places.setdefault(last, place)
        self.names = [known.get(number) for number in range(max([-1, *known, *self._places]) + 1)]
        self._movable_places = {g: p for g, p in self._movable_places.items() if 0 <= g < len(self.names)}
        self.all_known = self._index is not None or (None not in self.names and self._is_last(last, records))

    def _is_last(self, gop: int, records: dict[int, Any]) -> bool:
        """Tell whether the index, damaged as it is, starts right after what was found last."""
        at = max([0, *records])
        if gop in self._places:
            after = self._movable_places.get(gop, self._places[gop]).end
            while self._data[after : after + 1] == bytes([Opcode.MESSAGE_INDEX]):
                head = self._data[after : after + RECORD_HEAD].ljust(RECORD_HEAD, b"\0")
                after += RECORD_HEAD + struct.unpack("<BQ", head)[1]
                at = max(at, after)
        return self._data.find(INDEX.encode(), at, at + 64) == at + RECORD_HEAD + 20


def _listed(summary: bytes) -> Counter[str]:
    """Count what a summary lists, as far as it can be read: chunks by compression, the rest by what its names begin with."""
    found: Counter[str] = Counter()
    with suppress(*BROKEN):
        for opcode, _, content in records(summary):
            if opcode == Opcode.CHUNK_INDEX:
                found[ChunkIndex.read(stream(content)).compression] += 1
            elif opcode == Opcode.ATTACHMENT_INDEX:
                found[AttachmentIndex.read(stream(content)).name.partition(":")[0]] += 1
            elif opcode == Opcode.METADATA_INDEX:
                found[MetadataIndex.read(stream(content)).name.partition(":")[0]] += 1
    return found


def _labelled(scan: ScanPayload, labels: bytes) -> ScanPayload:
    return replace(scan, entry=replace(scan.entry, labels=len(labels)), labels=labels)


def _entry(name: str, data: bytes) -> ScanEntry:
    """Count again what the lost index said of a scan; what was lost to the grid counts as dropped."""
    if data[:1] == bytes([GRID_CODEC]):
        grid, streams = grid_payload.unpack(data)
        n_points, kept, strays, coded = grid.n_points, grid.returns, 0, grid_payload.pack(grid, streams)
    else:
        header, streams = payload.unpack(data)
        n_points, strays, coded = header.n_points, header.strays, payload.pack(header, streams)
        kept = header.returns + strays
    return ScanEntry(name, n_points, kept, n_points - kept, strays, **coded.sizes)
