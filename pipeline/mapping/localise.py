"""Localise in decoded scans: register consecutive ones and compare with ground truth (the paper's Table V)."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa

from salpcc.pipeline.mapping.localise_tasks import Rival, Stretch, calibrate, register_stretch
from salpcc.pipeline.mapping.make_map import NO_CLASSES
from salpcc.pipeline.mapping.map_plan import F64
from salpcc.pipeline.plan.plan import check_original
from salpcc.pipeline.schedule.cluster import connect
from salpcc.pipeline.schedule.flow import each
from salpcc.pipeline.schedule.lock import locked
from salpcc.pipeline.schedule.progress import bar
from salpcc.pipeline.schedule.store import ShardStore
from salpcc.schemas.errors import SourceError, UsageError
from salpcc.stages.evaluate.report import record
from salpcc.stages.evaluate.report.schema import REGISTRATION
from salpcc.stages.ingest.sources import SOURCES
from salpcc.stages.mapping.drive.poses import poses_of, read_poses
from salpcc.stages.mapping.open3d_library import load_open3d
from salpcc.stages.residual_code.archive.reader import ArchiveReader


@dataclass(frozen=True)
class LocaliseRequest:
    """What is compared: archives of the same sequences coded in different ways, against a root with poses.

    ``rivals`` are baselines that decode to as many bits a point as each archive that is not bit-exact;
    ``every`` takes every n-th pair, ``thin`` every n-th point of the scan that is registered.
    """

    archives: list[Path]
    against: Path
    out: Path
    rivals: tuple[str, ...] = ()
    every: int = 1
    thin: int = 1
    workers: int | None = None
    scheduler: str | None = None
    quiet: bool = False


def localise(request: LocaliseRequest) -> pa.Table:
    """Register every pair of consecutive scans in every way; return the REGISTRATION table that is recorded.

    Raises:
        UsageError, SourceError: no root, no poses, archives that do not hold the same scans; no Open3D.
    """
    load_open3d()  # before an hour of work, not after it
    if not request.archives:
        raise UsageError("no archive: name at least one, such as out/archives/04.mcap")
    by_sequence: dict[str, list[ArchiveReader]] = {}
    for path in request.archives:
        reader = ArchiveReader(path)
        by_sequence.setdefault(reader.facts.sequence, []).append(reader)
    stretches = [s for readers in by_sequence.values() for s in _stretches(readers, request)]
    if not stretches:
        raise UsageError(f"{request.archives[0]}: no two consecutive scans to register (--every?)")
    with ExitStack() as stack:
        stack.enter_context(locked(request.out))
        ShardStore(request.out).sweep()
        steps = sum(len(s.pairs) for s in stretches)
        report = stack.enter_context(bar(steps, "pairs registered", request.quiet))
        client = stack.enter_context(connect(request.workers, request.scheduler))
        for reader in (reader for readers in by_sequence.values() for reader in readers):
            if reader.movable == "one layer" and not reader.has_classes:
                report.say(f"{reader.path}: {NO_CLASSES}; it is registered with them only")
        asked = [
            (str(reader.path), str(request.against), name)
            for name in request.rivals
            for readers in by_sequence.values()
            for reader in readers
            if reader.facts.config.get("max_error")
        ]
        rivals: dict[str, list[Rival]] = {}
        found = each(client, calibrate, asked, [f"calibrate-{Path(a[0]).stem}" for a in asked])
        for (archive, *_), rival in zip(asked, found, strict=True):
            rivals.setdefault(ArchiveReader(archive).facts.sequence, []).append(rival)
        ordered = {k: tuple(sorted(v, key=lambda r: (r.name, r.max_error))) for k, v in rivals.items()}
        work = [(s, ordered.get(s.sequence, ()), request.thin, request.out) for s in stretches]
        names = [f"register-{s.sequence}-{s.pairs[0][0]}" for s in stretches]
        told = [(len(s.pairs), f"{s.sequence}: registered from {s.pairs[0][0]}") for s in stretches]
        refs = each(client, register_stretch, work, names, report, told)
        table = ShardStore(request.out).together(refs, REGISTRATION)
    record.record(request.out, registration=table)
    return table


def _stretches(readers: Sequence[ArchiveReader], request: LocaliseRequest) -> list[Stretch]:
    """Cut a sequence into stretches of pairs, one per GOP of its first archive."""
    first = readers[0]
    facts = first.facts
    if request.against.is_file():
        raise UsageError(
            f"{request.against}: no root of data, below which poses.txt lies; scans of a log are localised in maps, by --map"
        )
    check_original(first.path, facts.source, request.against)
    names = first.names
    for reader in readers[1:]:
        for name, other in zip(names, reader.names, strict=False):
            if name != other:
                raise SourceError(f"{reader.path}: scan {other} stands where {first.path} has {name}")
        if len(reader.names) != len(names):
            raise SourceError(f"{reader.path}: not the {len(names)} scans of {first.path}")
    path = request.against / "sequences" / facts.sequence / "poses.txt"
    truth = poses_of(names, read_poses(path), path)
    refs = {ref.name: ref for ref in SOURCES[facts.source].scans(request.against, facts.sequence)}
    for name in names:
        if name not in refs:
            raise SourceError(f"{request.against}: scan {name} of sequence {facts.sequence} is not there")
    out = []
    at = 0
    for gop in first.gops:
        pairs = [
            i
            for i in range(at, at + len(gop))
            if i + 1 < len(names) and i % request.every == 0 and _next(names, i)
        ]
        at += len(gop)
        if pairs:
            out.append(
                Stretch(
                    facts.sequence,
                    facts.source,
                    tuple(str(reader.path) for reader in readers),
                    tuple((names[i], names[i + 1]) for i in pairs),
                    tuple((i, i + 1) for i in pairs),
                    tuple((refs[names[i]], refs[names[i + 1]]) for i in pairs),
                    tuple(_step(truth, i) for i in pairs),
                )
            )
    return out


def _next(names: list[str], at: int) -> bool:
    """Tell whether two neighbours in an archive are neighbours in time."""
    a, b = names[at], names[at + 1]
    return not (a.isdecimal() and b.isdecimal()) or int(b) == int(a) + 1


def _step(truth: F64, at: int) -> tuple[float, ...]:
    return tuple((np.linalg.inv(truth[at]) @ truth[at + 1]).ravel().tolist())
