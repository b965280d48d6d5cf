"""Digests of the files that go into a run, and which of those on record still hold.

A digest on record holds while the mark of its file does: size, inode, time of modification and time of change,
or what a store tags the content with. So a run over what is done looks at its files and reads none. Whatever
writes to a file moves its time of change, also who sets the modification time back; a file that was changed less
than two seconds before it was read gets no mark. What escapes is a clock that is set back, and what changes
beneath the file system. ``verify --against`` believes no mark: it reads every byte.
"""

from __future__ import annotations

import hashlib
import warnings
from dataclasses import replace
from pathlib import Path

from salpcc.pipeline.plan.plan import SequencePlan
from salpcc.pipeline.plan.side_files import read_side
from salpcc.schemas.config import RunConfig
from salpcc.schemas.errors import LogWarning
from salpcc.schemas.files import location, reading, unreachable
from salpcc.schemas.marks import at_rest, mark, marks
from salpcc.schemas.work import GopSource, Known, ScanRef
from salpcc.stages.ingest.sources.bag import digest_log, log_files, log_mark


def recall(plan: SequencePlan, known: Known, config: RunConfig) -> SequencePlan:
    """Fill in the digests that are on record and hold; that of a log, which all its messages share, in any case.

    Args:
        known: by name of a file, the mark and digest on record.

    Raises:
        SourceError: the log, or a side file, cannot be read.

    Warns:
        LogWarning: of a side file that is no text and stays behind.
    """
    plan = _recall_side(plan, known)
    refs = [ref for gop in plan.gops for ref in gop.scans]
    if refs[0].topic:
        holds = _of_log(location(refs[0].path), known)
        digests = {refs[0].path: holds[1]}
        still = {Path(refs[0].path).name: holds} if holds[0] else {}
    elif known:
        labels = {ref.labels for ref in refs if ref.labels and config.reads_labels(ref)}
        paths = [location(name) for name in sorted({ref.path for ref in refs} | labels)]
        found = {path: now for path, now in marks(paths).items() if known.get(path.name, ("", ""))[0] == now}
        digests = {str(path): known[path.name][1] for path in found}
        still = {path.name: known[path.name] for path in found}
    else:
        return plan

    def told(ref: ScanRef) -> ScanRef:
        labels_digest = digests.get(ref.labels or "", "")
        return replace(ref, digest=digests.get(ref.path, ""), labels_digest=labels_digest)

    gops = tuple(replace(gop, scans=tuple(told(ref) for ref in gop.scans)) for gop in plan.gops)
    return replace(plan, gops=gops, known=plan.known | still)


def _recall_side(plan: SequencePlan, known: Known) -> SequencePlan:
    """The digests of side files: those on record that hold, the others by reading; what is no text is left out."""
    paths = {ref.name: location(ref.path) for ref in plan.side}
    now = marks(paths.values())
    side, learned = [], {}
    for ref in plan.side:
        path, key = paths[ref.name], f"side:{ref.name}"
        if key in known and known[key][0] == now.get(path):
            learned[key] = known[key]
        else:
            data = read_side(ref)
            if b"\0" in data:
                warnings.warn(f"{path}: no text, so it stays behind", LogWarning, stacklevel=2)
                continue
            digest = hashlib.sha256(data).hexdigest()
            learned[key] = now[path] if at_rest(path) else "", digest
        side.append(replace(ref, digest=learned[key][1]))
    return replace(plan, side=tuple(side), known={key: row for key, row in learned.items() if row[0]})


def all_known(gop: GopSource, config: RunConfig) -> bool:
    """Tell whether no file of a GOP has to be read for its digest."""
    return all(
        ref.digest and (ref.labels_digest or not (ref.labels and config.reads_labels(ref)))
        for ref in gop.scans
    )


def digest_scan(ref: ScanRef, with_labels: bool) -> tuple[list[str], Known]:
    """SHA-256 of the files of a scan, each read if it is not known; and what was learned by that."""
    digests, learned = [], {}
    for path, known in ((ref.path, ref.digest), (ref.labels, ref.labels_digest))[: 2 if with_labels else 1]:
        if path is None or known:
            digests.append(known or "absent")
            continue
        now, digest = _read(location(path))
        digests.append(digest)
        if now:
            learned[Path(path).name] = now, digest
    return digests, learned


def _read(path: Path) -> tuple[str, str]:
    """The mark of a file, empty where it is not to be relied on, and its SHA-256, or a word for why there is none."""
    try:
        now = mark(path) if at_rest(path) else ""
        with reading(path) as stream:
            return now, hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError as error:  # it will fail in ingest too, and be done again once it is readable
        if unreachable(error):
            raise
        return "", f"unreadable: {error.errno}"


def _of_log(path: Path, known: Known) -> tuple[str, str]:
    now = log_mark(path)
    if known.get(path.name, ("", ""))[0] == now:
        return known[path.name]
    rests = all(at_rest(file) for file in log_files(path))
    return now if rests else "", digest_log(path)
