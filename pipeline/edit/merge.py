"""Put archives together: coded scans, and what else their logs recorded, are copied."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from hashlib import blake2b
from itertools import chain
from pathlib import Path

from salpcc.pipeline.edit.cut import Counts, check_new, taken
from salpcc.schemas.errors import UsageError
from salpcc.schemas.log import LogMessage, known_as
from salpcc.schemas.passing_log import PassingLog
from salpcc.stages.residual_code.archive.format import ScanPayload
from salpcc.stages.residual_code.archive.reader import ArchiveReader
from salpcc.stages.residual_code.archive.side_files import SideFile
from salpcc.stages.residual_code.archive.writer import write_archive
from salpcc.stages.residual_code.paper.grid_header import GRID_CODEC
from salpcc.stages.residual_code.sensor.payload import unpack


def merge(paths: list[Path], out: Path) -> Counts:
    """Write the scans of several archives to a new one, ``out``.

    Archives of one sequence are ordered by time, others as they are given; these are of a sequence that has the name of
    ``out`` then. Files keep their names; clouds of logs, whose names are numbers, go on counting where they would be
    named alike. Other messages of a log that several archives hold, as parts of one by topics do, are kept once.

    Raises:
        UsageError: ``out`` exists, a scan is in two archives, or they do not fit one another; the message says why.
        ArchiveError: one is damaged.
    """
    check_new(out)
    readers = [ArchiveReader(path) for path in paths]
    sequences = {reader.facts.sequence for reader in readers}
    if len(sequences) == 1:
        readers.sort(key=lambda reader: reader.span)
    first = readers[0]
    for other in readers[1:]:
        _check_alike(first, other)
    named = _names(readers)
    config = first.facts.config
    if first.log:
        numbers = [int(name.rpartition("-")[2]) for gops in named for gop in gops for name in gop]
        config = config | {"frames": [min(numbers, default=0), max(numbers, default=0) + 1]}
    sequence = first.facts.sequence if len(sequences) == 1 else out.stem
    labels = any(reader.facts.labels for reader in readers)
    facts = replace(first.facts, inputs="", sequence=sequence, config=config, labels=labels)
    counts, side = Counts(), _side(readers, apart=len(sequences) > 1)
    write_archive(out, facts, _gops(readers, named, counts), _log(readers), side)
    return counts


def _side(readers: list[ArchiveReader], apart: bool) -> list[SideFile]:
    """The side files of all archives; of several sequences each in a folder with the name of its sequence.

    Raises:
        UsageError: two archives of a sequence have one of other content.
    """
    found: dict[str, tuple[SideFile, ArchiveReader]] = {}
    for reader in readers:
        for name in reader.side:
            file = reader.side_file(name)
            if apart:
                file = replace(file, name=f"{reader.facts.sequence}/{name}")
            held, holder = found.setdefault(file.name, (file, reader))
            if held != file:
                raise UsageError(
                    f"{reader.path}: another {name} than in {holder.path}; one archive cannot hold both"
                )
    return [file for file, _ in found.values()]


def _check_alike(one: ArchiveReader, other: ArchiveReader) -> None:
    def differs(what: str) -> UsageError:
        return UsageError(f"{other.path}: {what} than in {one.path}; one archive cannot hold both")

    if one.facts.sensor.to_json() != other.facts.sensor.to_json():
        raise differs(f"another sensor model ({other.facts.sensor.name})")
    if bool(one.log) != bool(other.log):
        raise differs("scans of a log" if other.log else "scans of files")
    if one.movable != other.movable:
        raise differs(f"what may move is {other.movable}, otherwise")
    here, there = one.facts.config, other.facts.config
    options = {key for key in here.keys() | there.keys() if here.get(key) != there.get(key)} - {"frames"}
    if options:
        raise differs(f"coded with another {', '.join(sorted(options))}")


def _names(readers: list[ArchiveReader]) -> list[list[list[str]]]:
    """The names of the scans in the new archive, by archive and GOP.

    Raises:
        UsageError: two files have one name, or a cloud is in two archives.
    """
    if readers[0].log:
        _check_no_cloud_twice(readers)
    named = [[[entry.name for entry in gop] for gop in reader.gops] for reader in readers]
    seen: dict[str, ArchiveReader] = {}
    next_number = 0
    for reader, gops in zip(readers, named, strict=True):
        twice = {name for gop in gops for name in gop} & seen.keys()
        if twice and not reader.log:
            name = min(twice)
            raise UsageError(
                f"scan {name} is in {seen[name].path} and in {reader.path}; merge takes parts of a sequence, "
                "or sequences whose scans have other names"
            )
        for gop in gops if twice else ():
            numbers = [name.rpartition("-") for name in gop]
            gop[:] = [f"{topic}{dash}{int(n) + next_number:06d}" for topic, dash, n in numbers]
        seen |= {name: reader for gop in gops for name in gop}
        if reader.log:
            next_number = max(int(name.rpartition("-")[2]) for name in seen) + 1 if seen else 0
    return named


def _check_no_cloud_twice(readers: list[ArchiveReader]) -> None:
    """Refuse parts of a log that overlap. What archives call a cloud tells nothing: each counts from where it begins."""
    seen: dict[tuple[str, int], tuple[ArchiveReader, int, int]] = {}  # by topic and time
    for reader in readers:
        clouds = [
            ((entry.name.rpartition("-")[0], time), (reader, gop, place))
            for gop, entries in enumerate(reader.gops)
            for place, (entry, time) in enumerate(zip(entries, reader.times(gop), strict=True))
        ]
        for key, here in clouds:
            there = seen.get(key)
            if there is not None and _content(*here) == _content(*there):
                names = [of.gops[gop][place].name for of, gop, place in (here, there)]
                raise UsageError(
                    f"{reader.path}: scan {names[0]} is in {there[0].path}, too, as {names[1]}; cut one of them, "
                    "so that each scan is in one archive only"
                )
        seen |= clouds


def _content(reader: ArchiveReader, gop: int, place: int) -> bytes | int:
    """What tells a coded scan from others; one that was coded anew is still the same."""
    data = reader.payloads(gop)[place].data
    return data if data[:1] == bytes([GRID_CODEC]) else unpack(data)[0].content_crc


def _gops(
    readers: list[ArchiveReader], named: list[list[list[str]]], counts: Counts
) -> Iterator[list[ScanPayload]]:
    for reader, gops in zip(readers, named, strict=True):
        for gop, names in enumerate(gops):
            payloads = taken(reader, gop, [entry.name for entry in reader.gops[gop]], counts)
            if payloads:
                yield [_renamed(payload, name) for payload, name in zip(payloads, names, strict=True)]


def _renamed(payload: ScanPayload, name: str) -> ScanPayload:
    return replace(
        payload,
        entry=replace(payload.entry, name=name),
        movable=payload.movable and _renamed(payload.movable, name),
    )


def _log(readers: list[ArchiveReader]) -> PassingLog | None:
    """What the logs recorded besides scans: one after the other, channels that tell the same are one.

    What logs enclose is kept once where it is the same.

    Raises:
        UsageError: a topic of clouds has several channels, and the archives not the same ones.
    """
    if not readers[0].log:
        return None
    # Parts of one log know their channels by the same numbers, be they of other topics.
    channels = {number: channel for reader in readers for number, channel in reader.log.items()}
    new_id: list[dict[int, int]] = []
    if all(channels[number] == channel for reader in readers for number, channel in reader.log.items()):
        new_id = [{number: number for number in channels} for _ in readers]
    else:
        channels = {}
        for reader in readers:
            ids: dict[int, int] = {}
            for number, channel in reader.log.items():
                ids[number] = known_as(channel, channels, ids.values()).id
            new_id.append(ids)
        clouds = [(c.topic, c.encoding) for c in channels.values() if c.holds_clouds]
        if twice := sorted({c for c in clouds if clouds.count(c) > 1}):
            # A coded cloud says by number on which channel it came.
            raise UsageError(
                f"{readers[0].path}, …: topic {twice[0][0]} has several channels, not the same in each archive"
            )
    enclosed = []
    for found in chain.from_iterable(reader.enclosed() for reader in readers):
        if found not in enclosed:
            enclosed.append(found)
    return PassingLog(channels.values(), _messages(readers, new_id), enclosed)


def _messages(readers: list[ArchiveReader], new_id: list[dict[int, int]]) -> Iterator[LogMessage]:
    """The messages of one archive after the other, those that an archive before holds, too, only once."""
    held: Counter[tuple[int | bytes, ...]] = Counter()
    for place, (reader, ids) in enumerate(zip(readers, new_id, strict=True)):
        others = [other.passing_span for other in readers[:place] + readers[place + 1 :]]
        here: Counter[tuple[int | bytes, ...]] = Counter()
        for recorded in reader.passing():
            message = replace(recorded, channel=ids[recorded.channel])
            if any(first <= message.log_time <= last for first, last in others):  # else no other holds it
                content = blake2b(message.data, digest_size=16).digest()
                told = (message.channel, message.log_time, message.publish_time, message.sequence, content)
                here[told] += 1
                if here[told] <= held[told]:
                    continue
            yield message
        held |= here
