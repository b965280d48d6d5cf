"""Take scans out of archives; coded scans are copied.

Only where scans are taken from a group without those before them are they coded anew, for a group is decoded from its
first scan on.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from math import isfinite
from pathlib import Path

from salpcc.pipeline.decode import decoded_scans
from salpcc.schemas.errors import ArchiveError, UsageError
from salpcc.schemas.files import is_url, there
from salpcc.schemas.log import LogMessage
from salpcc.schemas.passing_log import PassingLog
from salpcc.schemas.sweep import Sweep
from salpcc.stages.lattice.sensor_model import SensorModel
from salpcc.stages.residual_code.archive.format import ScanPayload, frame_number
from salpcc.stages.residual_code.archive.reader import ArchiveReader
from salpcc.stages.residual_code.archive.writer import write_archive
from salpcc.stages.residual_code.gop import decode_any, encode_layers
from salpcc.stages.residual_code.sensor.gop_state import GopState
from salpcc.stages.residual_code.sensor.payload import unpack
from salpcc.stages.residual_code.sensor.scan_coder import decode_scan
from salpcc.stages.residual_code.stream import Payload


@dataclass
class Counts:
    """What became of the scans that were taken."""

    copied: int = 0
    anew: int = 0
    behind: frozenset[str] = frozenset()  # topics whose messages stayed behind

    @property
    def scans(self) -> int:
        """All of them."""
        return self.copied + self.anew

    @property
    def told(self) -> str:
        """In words."""
        if not self.scans:
            return "no scan, messages of other topics only"
        how = f"{self.copied} copied" + (f", {self.anew} coded anew and compared" if self.anew else "")
        topics = f"; messages of {', '.join(sorted(self.behind))} stay behind, which cut takes along"
        return f"{self.scans} scan{'' if self.scans == 1 else 's'}, {how}" + (topics if self.behind else "")


@dataclass(frozen=True)
class Selection:
    """Which scans of an archive are taken: those that meet all of what is given.

    Attributes:
        frames: ``[first, last)`` of their numbers; a scan's number is its name where that is one, else its place.
        seconds: ``[first, last)`` after the first scan of the archive.
        topics: of these channels of the log only.
    """

    frames: tuple[int, int] | None = None
    seconds: tuple[float, float] | None = None
    topics: tuple[str, ...] = ()

    def covers(self, number: int, seconds: float) -> bool:
        """Tell whether a scan is of the frames and of the time."""
        of_frames = self.frames is None or self.frames[0] <= number < self.frames[1]
        return of_frames and (self.seconds is None or self.seconds[0] <= seconds < self.seconds[1])


def cut(path: Path, out: Path, selection: Selection) -> Counts:
    """Write the scans of ``path`` that are selected, and what its log recorded between them, to a new archive ``out``.

    Raises:
        UsageError: ``out`` exists, no scan and no message is selected, or groups of the profile ``paper`` would have to be opened.
        ArchiveError: the archive is damaged.
    """
    reader = ArchiveReader(path)
    names, window = _selected(reader, selection)
    log = None
    if reader.log:
        channels = [c for c in reader.log.values() if not selection.topics or c.topic in selection.topics]
        kept = {channel.id for channel in channels}
        messages = (m for m in reader.passing() if m.channel in kept and _within(m, window))
        log = PassingLog(channels, messages, reader.enclosed())
    if not any(names) and (log is None or log.ended):
        first, last = reader.span
        raise UsageError(
            f"{path}: no scan of it is selected{', and no message' if log else ''}; "
            f"{reader.held}, {(last - first) / 1e9:.1f} s"
        )
    return write_part(reader, names, out, log)


def write_part(
    reader: ArchiveReader, names: Sequence[Collection[str]], out: Path, log: PassingLog | None = None
) -> Counts:
    """Write the scans that are named, by GOP, to a new archive.

    Raises:
        UsageError, ArchiveError: as in :func:`cut`.
    """
    check_new(out)
    facts = reader.facts
    config = facts.config
    if reader.log:  # whoever compares it with the log must know that it is not all of it
        numbers = [int(name.rpartition("-")[2]) for gop in names for name in gop]
        config = config | {"frames": [min(numbers), max(numbers) + 1] if numbers else [0, 0]}
    counts = Counts()
    gops = (part for gop, wanted in enumerate(names) if (part := taken(reader, gop, wanted, counts)))
    # Without its inputs no run takes it for the archive that it would make.
    side = map(reader.side_file, reader.side)
    write_archive(out, replace(facts, inputs="", config=config), gops, log, side)
    return counts


def check_new(out: Path) -> None:
    """Refuse to write over a file.

    Raises:
        UsageError: it is there.
    """
    if there(out):
        raise UsageError(f"{out}: exists; name a new file")
    if not is_url(out) and out.suffix != ".mcap":
        raise UsageError(f"{out}: an archive is a file NAME.mcap")


def taken(reader: ArchiveReader, gop: int, names: Collection[str], counts: Counts) -> list[ScanPayload]:
    """Return the coded scans of a GOP that are named; its first ones as they are, others coded anew.

    Raises:
        UsageError: scans of the profile ``paper`` would have to be coded anew.
        ArchiveError: the GOP is damaged.
    """
    if not names:
        return []
    static = reader.payloads(gop)
    moving: list[ScanPayload | None] = [*reader.movable_payloads(gop)]
    moving += [None] * (len(static) - len(moving))
    payloads = [replace(one, movable=other) for one, other in zip(static, moving, strict=True)]
    places = [place for place, payload in enumerate(payloads) if payload.entry.name in names]
    few = [payloads[place] for place in places]
    if places == list(range(len(places))):
        counts.copied += len(few)
        return few
    counts.anew += len(few)
    return _coded_anew(reader, payloads[: places[-1] + 1], places)


def _coded_anew(reader: ArchiveReader, payloads: list[ScanPayload], places: list[int]) -> list[ScanPayload]:
    sensor = reader.facts.sensor
    effort = str(reader.facts.config.get("effort", "default"))
    sweeps: list[Sweep] = []
    for sweep in decode_any((payload.data for payload in payloads), sensor):
        if not isinstance(sweep, Sweep):
            names = payloads[0].entry.name, payloads[places[0]].entry.name
            raise UsageError(
                f"{reader.path}: a group of the profile paper is taken from its first scan on, {names[0]}, "
                f"not from {names[1]}"
            )
        sweeps.append(sweep)
    if len(sweeps) != len(payloads):
        raise ArchiveError(f"{reader.path}: scan {payloads[len(sweeps)].entry.name} does not decode")
    state = GopState(sensor)
    pairs = [
        (sweep, decode_scan(payload.movable.data, sensor, state, sweep) if payload.movable else None)
        for payload, sweep in zip(payloads, sweeps, strict=True)
    ]
    few = [payloads[place] for place in places]
    coded = encode_layers([pairs[place] for place in places], sensor, effort)
    result = [
        replace(_as(old, static), movable=_as(old.movable, movable) if old.movable and movable else None)
        for old, (static, movable) in zip(few, coded, strict=True)
    ]
    _check_same(reader, few, result, sensor)
    return result


def _as(old: ScanPayload, new: Payload) -> ScanPayload:
    return replace(old, data=new.data, entry=old.entry.of_sizes(new.sizes), movable=None)


def _check_same(
    reader: ArchiveReader, old: list[ScanPayload], new: list[ScanPayload], sensor: SensorModel
) -> None:
    """Decode what was coded anew, and compare the checksums of what is decoded.

    Raises:
        ArchiveError: it is something else; that is a fault of this tool.
    """

    def contents(payload: ScanPayload) -> list[int]:
        layers = [layer for layer in (payload, payload.movable) if layer]
        return [unpack(layer.data)[0].content_crc for layer in layers]

    # Decoding compares what came with the checksum of the content that the payload states.
    both = [payload for payload in new if payload.movable]
    came = list(decoded_scans(both, sensor, True)) if both else []
    came += list(decoded_scans(new, sensor, False))
    if len(came) != len(both) + len(new) or [*map(contents, old)] != [*map(contents, new)]:
        raise ArchiveError(f"{reader.path}: scans of it do not come back from what they were coded to anew")


def _selected(
    reader: ArchiveReader, selection: Selection
) -> tuple[list[list[str]], tuple[int | None, int | None]]:
    """Names of the scans that are taken, by GOP; and from when to when (ns) other messages of the log are, None for open."""
    start, _ = reader.span if any(reader.gops) else reader.passing_span
    topics = _topics(reader) if selection.topics else None
    if topics is not None and (wrong := set(selection.topics) - {c.topic for c in reader.log.values()}):
        there = ", ".join(sorted({c.topic for c in reader.log.values()})) or "none, its scans were files"
        raise UsageError(f"{reader.path}: topic {min(wrong)} is not in it (topics: {there})")
    place = 0
    names: list[list[str]] = []
    within: list[int] = []  # times of the scans of the frames and seconds asked for, of any topic
    without: list[int] = []
    for gop, entries in enumerate(reader.gops):
        of_topic = topics is None or topics[gop] in selection.topics
        names.append([])
        for entry, time in zip(entries, reader.times(gop), strict=True):
            if selection.covers(frame_number(entry.name, place), (time - start) / 1e9):
                within.append(time)
                names[-1] += [entry.name] * of_topic
            else:
                without.append(time)
            place += 1
    if not within:
        return names, _between(start, selection)
    first, last = min(within), max(within)
    # What was recorded before the first scan of all stays with that, what came after the last one with the last.
    begins = any(time < first for time in without)
    return names, (first if begins else None, min((t for t in without if t > last), default=None))


def _between(start: int, selection: Selection) -> tuple[int | None, int | None]:
    """From when to when messages are that no scan is among: those of the seconds; none of frames that are not there."""
    if selection.seconds is None or selection.frames is not None:
        return 0, 0
    first, last = (start + round(1e9 * s) if isfinite(s) else None for s in selection.seconds)
    return first, last


def _topics(reader: ArchiveReader) -> list[str]:
    """The topic of each GOP: what the first of its scans was recorded on."""
    found = []
    for gop, entries in enumerate(reader.gops):
        scan = next(decoded_scans(reader.payloads(gop)[:1], reader.facts.sensor, False)) if entries else None
        found.append(scan.cloud.topic if scan is not None and scan.cloud is not None else "")
    return found


def _within(message: LogMessage, window: tuple[int | None, int | None]) -> bool:
    first, last = window
    return (first is None or first <= message.log_time) and (last is None or message.log_time < last)
