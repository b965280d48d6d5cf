"""Pseudo-labels: what a trained network is sure of, where nobody has labelled.

Boxes label a sixth of a scan, most recorded scans have no labels at all. A teacher labels the rest: the network with all
that it has beside a single look (the mirrored scan, the scans before and after, objects), which is more than its pupil is
shown. Of what it is not sure of nothing is said, and what boxes say stands (self-training; Xie et al., CVPR 2020).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from salpcc.schemas.files import atomic
from salpcc.schemas.labels import CLASSES, GROUND, GROUP_OF_CLASS, MOVABLE, OTHER
from salpcc.schemas.scan import Scan
from salpcc.schemas.work import ScanRef
from salpcc.stages.ingest.sources.semantickitti import SemanticKitti
from salpcc.stages.segment.labelling import joined, judge_group
from salpcc.stages.segment.network.projection import project
from salpcc.stages.segment.network.quantised import LabellingNetwork
from salpcc.stages.segment.segmenter import Segmentation, by_group, class_scores
from salpcc.stages.segment.training.labelled import consecutive, not_movable, raw_labels, sequence_of

_SURE_MOVABLE = 0.95  # of the pixels said to be so with 0.8 to 0.9 every second is
_SURE_STATIC = 0.05  # probability to be movable
_SURE_CLASS = 0.8  # probability of ground or other, to say which
_LIKELY = 0.3  # probability to be movable of what may be a bicycle
_PARKED = [i for i, c in enumerate(CLASSES) if c.name in ("bicycle", "motorcycle")]
_IN_NO_BOX = 99
_WHOLE = 0.5  # of the points of a scan; boxes cover a sixth
_GROUP = 8
_ID = np.array([c.ids[0] if c.ids else 0 for c in CLASSES], np.uint32)


@dataclass(frozen=True, eq=False)
class Said:
    """What a teacher says of the points of a scan.

    Attributes:
        labels: ``(N,)`` uint32, SemanticKITTI's ids: 0 where it is not sure, 99 where it is sure of no more than that
            a point is not movable.
        parked: ``(N,)`` whether a point may be a parked bicycle's or motorcycle's, which have no boxes.
    """

    labels: NDArray[np.uint32]
    parked: NDArray[np.bool_]


def complete_labels(
    network: LabellingNetwork, refs: Sequence[ScanRef], out: Path, log: Callable[[str], None] = print
) -> list[ScanRef]:
    """Label what nobody has labelled, and return all scans to train on.

    Scans with boxes are returned twice, with what boxes tell and with all that is known, scans without labels once. Their
    labels are written to ``OUT/boxes`` and ``OUT/all``.
    """
    completed: list[ScanRef] = []
    folders = {
        name: f"{k:03d}" for k, name in enumerate(dict.fromkeys(Path(ref.path).parent for ref in refs))
    }
    for group in consecutive(refs, _GROUP):
        scans = [SemanticKitti().read(ref, with_labels=False) for ref in group]
        given = [raw_labels(ref, scan.points) for ref, scan in zip(group, scans, strict=True)]
        whole = [bool((labels != 0).mean() > _WHOLE) for labels in given]
        completed += [ref for ref, labelled in zip(group, whole, strict=True) if labelled]
        if all(whole):
            continue
        log(f"the teacher labels {sequence_of(group[0])}, {group[0].name} to {group[-1].name}")
        for ref, labels, labelled, said in zip(group, given, whole, teach(network, scans), strict=True):
            if labelled:
                continue
            boxes, every = join_labels(labels, said)
            for kind, joint in (("boxes", boxes), ("all", every)) if labels.any() else (("all", every),):
                path = out / kind / folders[Path(ref.path).parent] / f"{ref.name}.label"
                path.parent.mkdir(parents=True, exist_ok=True)
                with atomic(path) as stream:
                    stream.write(joint.tobytes())
                completed.append(replace(ref, labels=str(path)))
    return completed


def teach(network: LabellingNetwork, scans: Sequence[Scan]) -> list[Said]:
    """Ask a network what it is sure of in the scans of a group, of one drive or of many."""
    found = [_twice(network, scan) for scan in scans]
    judged = judge_group(found, joined(scans), [None] * len(found))
    return [_sure(one, len(scan.points)) for one, scan in zip(judged, scans, strict=True)]


def join_labels(labels: NDArray[np.uint32], said: Said) -> tuple[NDArray[np.uint32], NDArray[np.uint32]]:
    """Return the labels ``(N,)`` that boxes tell, and those with what a teacher says beside.

    Boxes are right, but do not tell what is in no box, nor that bicycles and motorcycles without a rider have none.
    """
    boxes = labels.copy()
    boxes[not_movable(labels) & said.parked] = 0
    every = np.where(boxes == 0, said.labels, boxes)
    named = not_movable(boxes) & (said.labels != 0) & ~np.isin(said.labels, _ID[GROUP_OF_CLASS == MOVABLE])
    every[named] = said.labels[named]
    every[not_movable(labels) & said.parked] = 0
    return boxes, every


def _twice(network: LabellingNetwork, scan: Scan) -> Segmentation:
    """What the network says of a scan and of its mirror image, in the mean."""
    image, scores = class_scores(network, project(scan.points, scan.intensity))
    mirrored = scan.points * np.array([1, -1, 1], np.float32)
    _, other = class_scores(network, project(mirrored, scan.intensity))
    mean = ((scores + other[:, ::-1]) / 2).astype(np.float32)
    return by_group(image, mean)


def _sure(found: Segmentation, n: int) -> Said:
    seen = found.image.index >= 0
    groups, best = found.groups[:, seen], found.best[:, seen]
    labels = np.zeros(groups.shape[1], np.uint32)
    labels[groups[MOVABLE] <= _SURE_STATIC] = _IN_NO_BOX
    for group in (GROUND, OTHER):
        sure = (groups[MOVABLE] <= _SURE_STATIC) & (groups[group] >= _SURE_CLASS)
        labels[sure] = _ID[best[group, sure]]
    sure = groups[MOVABLE] >= _SURE_MOVABLE
    labels[sure] = _ID[best[MOVABLE, sure]]
    said = Said(np.zeros(n, np.uint32), np.zeros(n, np.bool_))
    said.labels[found.image.index[seen]] = labels
    said.parked[found.image.index[seen]] = (groups[MOVABLE] > _LIKELY) & np.isin(best[MOVABLE], _PARKED)
    return said
