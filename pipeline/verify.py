"""Verify an archive: checksums of everything, and every point against its source."""

from __future__ import annotations

from collections import Counter
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from salpcc.pipeline.against import Originals, bounds, places_in_source
from salpcc.pipeline.decode import DecodeOptions, decode_groups
from salpcc.pipeline.edit.redact import check_redacted
from salpcc.pipeline.plan.logs import compare_log
from salpcc.pipeline.plan.side_files import compare_side
from salpcc.schemas.errors import ArchiveError, SourceError
from salpcc.schemas.scan import Scan
from salpcc.stages.evaluate.measures.metrics import point_errors, same_bits
from salpcc.stages.ingest.point_cloud import same_message
from salpcc.stages.ingest.sources import SOURCES
from salpcc.stages.residual_code.archive.reader import ArchiveReader


@dataclass
class Verdict:
    """What was found. Figures about errors stay None where nothing was compared."""

    archive: str
    sequence: str
    scans: int = 0
    points: int = 0
    against: str | None = None
    asked_max_error_m: float | None = None
    bit_exact_scans: int = 0
    points_dropped: int = 0
    scans_elsewhere: list[str] = field(default_factory=list)  # of the source, and not of the archive
    movable: str = ""
    layers: dict[str, dict[str, int]] | None = None
    labelled_scans: int = 0
    side_files: int = 0
    passed_messages: int | None = None
    max_error_m: float | None = None
    problems: list[str] = field(default_factory=list)

    @property
    def good(self) -> bool:
        """Tell whether nothing is wrong."""
        return not self.problems

    def as_dict(self) -> dict[str, Any]:
        """The verdict as JSON, with ``good`` first."""
        return {"good": self.good, **asdict(self)}


def verify(
    path: Path, against: Path | None = None, threads: int = 1, redacted_from: Path | None = None
) -> Verdict:
    """Decode all of an archive; with ``against`` (a data root), compare each point with its source.

    With ``redacted_from``, the manifest of a redaction, compare its chunks with those that were redacted.

    What is damaged is listed under ``problems``; other GOPs are still verified. ``threads`` GOPs are decoded at once.

    Raises:
        ArchiveError: the index itself is damaged, or this is no archive.
        UsageError: ``against`` is not there, or the archive was not made from files.
    """
    reader = ArchiveReader(path)
    facts = reader.facts
    verdict = Verdict(str(path), facts.sequence, asked_max_error_m=facts.config.get("max_error"))
    verdict.movable, verdict.layers = reader.movable, layer_sizes(reader)
    verdict.side_files = len(reader.side)
    if redacted_from is not None:
        verdict.problems += check_redacted(reader, redacted_from)
    source = Originals(reader, against) if against is not None else None
    verdict.against = str(against) if against is not None else None
    try:
        reader.check()
    except ArchiveError as error:
        verdict.problems.append(str(error))
    coded: Counter[str] = Counter()  # messages of a log, by topic
    groups = decode_groups(reader, range(len(reader.gops)), threads, DecodeOptions(labels=True))
    for entries, scans in zip(reader.entries, groups, strict=True):
        try:
            for entry, scan in zip(entries, scans, strict=True):
                verdict.scans += 1
                verdict.points += len(scan)
                verdict.labelled_scans += scan.labels is not None
                if len(scan) != entry.kept:
                    verdict.problems.append(
                        f"scan {entry.name}: {len(scan)} points, the index says {entry.kept}"
                    )
                coded[scan.cloud.topic if scan.cloud else ""] += 1
                if source is not None:
                    _compare(scan, source, facts.config, verdict, reader.movable == "dropped")
        except (ArchiveError, ValueError) as error:
            verdict.problems.append(str(error))
    verdict.problems += _side_problems(reader, source)
    if source is not None and not reader.log:
        _note_absent(reader, source, verdict)
    if source is not None and reader.log:
        passed, problems = compare_log(reader, source.root, coded, whole=not facts.config.get("frames"))
        verdict.passed_messages = passed
        verdict.problems += problems
    return verdict


def _note_absent(reader: ArchiveReader, source: Originals, verdict: Verdict) -> None:
    """Note which scans of the source the archive lacks. A run takes all from one frame to another: a gap is what failed there.

    What lies outside may have been recorded later, or is not of the run's ``--frames``; and parts of archives have gaps.
    """
    gaps, outside = source.absent({entry.name for gop in reader.entries for entry in gop})
    if reader.facts.inputs:  # of a run
        verdict.problems += [f"scan {name}: not in the archive, but in {source.root}" for name in gaps]
    verdict.scans_elsewhere = sorted([*gaps, *outside])


def _side_problems(reader: ArchiveReader, source: Originals | None) -> list[str]:
    """What is wrong with the side files: all are read, and compared with those of the data root where one is given."""
    if source is not None:
        folder = SOURCES[reader.facts.source].folder(source.root, reader.facts.sequence)
        return compare_side(reader, folder, source.refs.values())
    problems = []
    for name in reader.side:
        try:
            reader.side_file(name)
        except ArchiveError as error:
            problems.append(str(error))
    return problems


def _compare(scan: Scan, source: Originals, config: dict[str, Any], verdict: Verdict, dropped: bool) -> None:
    try:
        recorded, path = source.of(scan)
    except SourceError as error:
        verdict.problems.append(str(error))
        return
    compare(scan, recorded, path, config, verdict, dropped)


def compare(
    scan: Scan, source: Scan, path: str, config: dict[str, Any], verdict: Verdict, dropped: bool
) -> None:
    """Compare a decoded scan with its source, which is at ``path``, and say in the verdict what was found.

    Args:
        config: that the archive was coded with.
        dropped: what may move is not in the archive.
    """
    places = places_in_source(scan, source, config, dropped)
    if places is None:
        verdict.problems.append(f"scan {scan.name}: its {len(scan)} points are not those of {path}")
        return
    verdict.points_dropped += len(source) - len(scan)  # of a grid, with what it loses
    points, intensity = source.points[places], source.intensity[places]
    if config.get("profile") == "paper":
        _note_error(verdict, point_errors(points, scan.points).maximum)
        return
    kept = np.zeros(len(source), np.bool_)
    kept[places] = True
    if scan.labels is not None and (source.labels is None or not (source.labels[kept] == scan.labels).all()):
        verdict.problems.append(f"scan {scan.name}: its labels are not those of {path}")
    if not same_bits(intensity, scan.intensity):
        verdict.problems.append(f"scan {scan.name}: intensity differs from {path}")
    elif not same_message(
        source.cloud and source.cloud.keep(kept), scan.cloud, same_bits(points, scan.points)
    ):
        verdict.problems.append(f"scan {scan.name}: its message differs from {path}")
    elif same_bits(points, scan.points):
        verdict.bit_exact_scans += 1
    for which, bound in bounds(scan, config):
        worst = point_errors(points[which], scan.points[which]).maximum
        _note_error(verdict, worst)
        if not bound and not same_bits(points[which], scan.points[which]):
            verdict.problems.append(f"scan {scan.name}: not bit-exact with {path}")
        elif bound and worst > bound:
            verdict.problems.append(f"scan {scan.name}: an error of {worst} m, {bound} m was asked")


def _note_error(verdict: Verdict, error: float) -> None:
    verdict.max_error_m = max(verdict.max_error_m or 0.0, error)


def layer_sizes(reader: ArchiveReader) -> dict[str, dict[str, int]] | None:
    """Points and bytes of each layer of an archive: payloads, without the container; None where all is in one."""
    if reader.movable == "one layer":
        return None
    layers = {"static": reader.gops, "movable": reader.movable_gops}
    return {
        name: {
            "points": sum(entry.kept for gop in gops for entry in gop),
            "bytes": sum(entry.bytes for gop in gops for entry in gop),
        }
        for name, gops in layers.items()
    }
