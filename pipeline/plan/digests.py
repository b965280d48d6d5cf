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

from salpcc.pipeline.plan.plan import SequencePlan
from salpcc.pipeline.plan.side_files import read_side
from salpcc.schemas.config import RunConfig
from salpcc.schemas.errors import LogWarning
from salpcc.schemas.files import location
from salpcc.schemas.marks import at_rest, marks
from salpcc.schemas.work import GopSource, Known, ScanRef
from salpcc.stages.ingest.sources import SOURCES


def recall(plan: SequencePlan, known: Known, config: RunConfig) -> SequencePlan:
    """Fill in the digests that are on record and hold, and those of what all scans share.

    Args:
        known: by name of a file, the mark and digest on record.

    Raises:
        SourceError: the log, or a side file, cannot be read.

    Warns:
        LogWarning: of a side file that is no text and stays behind.
    """
    plan = _recall_side(plan, known)
    refs = [ref for gop in plan.gops for ref in gop.scans]
    digests, still = SOURCES[plan.gops[0].source].recall(refs, known, config)

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
