"""The plan of a run: which scans of which sequences, cut into GOPs."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from salpcc.pipeline.plan.records import recorded
from salpcc.pipeline.plan.side_files import list_side
from salpcc.schemas.config import RunConfig
from salpcc.schemas.errors import SourceError, UsageError
from salpcc.schemas.files import is_url
from salpcc.schemas.work import GopSource, Known, ScanError, ScanRef, SideRef
from salpcc.stages.ingest.sources import SOURCES


@dataclass(frozen=True)
class SequencePlan:
    """The GOPs of one sequence, in order; ``known`` are the digests that were not read again, ``side`` the files beside."""

    sequence: str
    gops: tuple[GopSource, ...]
    known: Known = field(default_factory=dict)
    side: tuple[SideRef, ...] = ()

    @property
    def n_scans(self) -> int:
        """Scans of all GOPs."""
        return sum(len(gop.scans) for gop in self.gops)


def plan_run(
    root: Path, sequences: list[str], config: RunConfig, out: Path | None = None
) -> tuple[list[SequencePlan], list[ScanError]]:
    """List the work. A sequence that is missing is an error of its own; the others go on.

    What is on record in ``out`` of a log that has not changed since spares going through it.

    Raises:
        UsageError: the root is missing, or none of the sequences is there; or ``out`` lies among the files that go into an archive.

    Warns:
        LogWarning: what else lies with the scans, or in their log, and stays behind.
    """
    source = SOURCES[config.source]
    with suppress(FileNotFoundError):
        root.stat()  # where a URL cannot be reached, this says so; is_dir() would only deny
    if not source.there(root):
        raise UsageError(
            f"{missing_root(root, config.source)} Pass --root DIR, or try it without data: "
            "salpcc-pipeline run sequences 00,01 --source simulated"
        )
    plans: list[SequencePlan] = []
    missing: list[ScanError] = []
    for sequence in sequences:
        try:
            record = recorded(out, sequence) if out else {}
            listed = source.asked(root, sequence, config, record)
            refs = select(listed, config.frames)
            if not listed:
                raise SourceError(f"{root}: sequence {sequence} has no scans")
            if not refs:
                numbers = [ref.number for ref in listed]
                raise SourceError(
                    f"{root}: sequence {sequence} has no scans in the frames asked for; frames {min(numbers)} to "
                    f"{max(numbers)} are there"
                )
        except SourceError as error:
            missing.append(ScanError(sequence, "", "ingest", str(error)))
            continue
        if config.side_files and out is not None:
            _check_apart(out, source.folder(root, sequence))
        side = list_side(config.source, root, sequence, listed) if config.side_files else ()
        plans.append(SequencePlan(sequence, cut(config.source, sequence, refs, config.gop), side=side))
    if not plans and source.passes:  # it is named by its file
        raise UsageError(missing[0].reason)
    if not plans:
        known = ", ".join(source.sequences(root)) or "none"
        raise UsageError(
            f"{missing[0].reason} (sequences there: {known}; to try without data: --source simulated)"
        )
    return plans, missing


def _check_apart(out: Path, folder: Path | None) -> None:
    """Refuse an output whose files the next run would take for those of a sequence."""
    if folder is None:
        return
    here, there = (path if is_url(path) else path.resolve() for path in (out, folder))
    if there in (here, *here.parents):
        raise UsageError(
            f"{out} lies in {folder}, whose files go into the archive; choose another --out, or --no-side-files"
        )


def missing_root(root: Path, source: str) -> str:
    """Begin the one line that a missing data root is answered with; the remedy follows it."""
    return f"data root {root} not found. {SOURCES[source].hint}."


def check_original(archive: Path | str, source: str, root: Path) -> None:
    """Refuse to compare an archive with a root that cannot hold what it was made from.

    Raises:
        UsageError: it was not made from files, or ``root`` is not there.
    """
    if source not in SOURCES:
        raise UsageError(f"{archive}: made from {source}, there are no files to compare with")
    if not SOURCES[source].there(root):
        raise UsageError(f"{missing_root(root, source)} Pass its place to --against")


def select(refs: list[ScanRef], frames: tuple[int, int] | None) -> list[ScanRef]:
    """Keep the scans whose frame number lies in ``[frames[0], frames[1])``.

    >>> refs = [ScanRef(f"{n:06d}", n, "", n) for n in range(5)]
    >>> [ref.number for ref in select(refs, (1, 3))]
    [1, 2]
    """
    return [ref for ref in refs if frames is None or frames[0] <= ref.number < frames[1]]


def cut(source: str, sequence: str, refs: list[ScanRef], size: int) -> tuple[GopSource, ...]:
    """Cut a sequence into GOPs of ``size`` scans of one topic, by time; the last may be shorter.

    >>> refs = [ScanRef(f"{n:06d}", n, "", n) for n in range(5)]
    >>> [len(gop.scans) for gop in cut("semantickitti", "04", refs, 2)]
    [2, 2, 1]
    """
    groups = []
    for topic in sorted({ref.topic for ref in refs}):
        of_topic = [ref for ref in refs if ref.topic == topic]
        groups += [tuple(of_topic[start : start + size]) for start in range(0, len(of_topic), size)]
    if len({ref.topic for ref in refs}) > 1:
        groups.sort(key=lambda group: (group[0].time, group[0].topic))
    return tuple(GopSource(source, sequence, number, group) for number, group in enumerate(groups))
