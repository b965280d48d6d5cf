"""Score a network on labelled scans: IoU per class and group, recall of movable points."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from salpcc.schemas.labels import CLASSES, GROUND, GROUP_OF_CLASS, GROUPS, MOVABLE, classes_of_labels
from salpcc.schemas.work import ScanRef
from salpcc.stages.ingest.sources.semantickitti import SemanticKitti
from salpcc.stages.segment.confusion import UNLABELLED, confusion, intersection_over_union, mean_iou
from salpcc.stages.segment.network.quantised import LabellingNetwork
from salpcc.stages.segment.segmenter import label_points
from salpcc.stages.segment.training.labelled import not_movable, raw_labels, sequence_of

TERRAIN = next(i for i, c in enumerate(CLASSES) if c.name == "terrain")
# Table I: vehicles, people and ground; the paper averages these twelve.
TWELVE = tuple(i for i, c in enumerate(CLASSES) if c.group and c.ids)


def count_scans(network: LabellingNetwork, refs: Iterable[ScanRef]) -> NDArray[np.int64]:
    """Return the confusion matrix ``(21, 21)`` of all points of the scans, truth by row.

    Points of scans with boxes that are known not to be movable, and no more, are in row 0.
    """
    counts = np.zeros((len(CLASSES), len(CLASSES)), np.int64)
    for ref in refs:
        scan = SemanticKitti().read(ref, with_labels=False)
        counts += count(raw_labels(ref, scan.points), label_points(network, scan.points, scan.intensity))
    return counts


def count(labels: NDArray[np.uint32], found: NDArray[np.uint8]) -> NDArray[np.int64]:
    """Count ``(21, 21)`` classes found ``(N,)`` against raw labels ``(N,)``, truth by row.

    What SemanticKITTI has no class for counts only where nothing but boxes is labelled, in row 0.
    """
    truth = classes_of_labels(labels)
    known = truth != UNLABELLED
    if not (GROUP_OF_CLASS[truth] == GROUND).any():
        known |= not_movable(labels)
    return confusion(truth[known], found[known], len(CLASSES))


def group_scores(counts: NDArray[np.int64], with_terrain: bool) -> dict[str, float]:
    """IoU of the groups from class counts, with points of terrain (72) or without."""
    rows = counts.copy()
    if not with_terrain:
        rows[TERRAIN] = 0
    movable = intersection_over_union(_by_group(rows), GROUPS).get(GROUPS[MOVABLE])
    rows[UNLABELLED] = 0  # tells movable from not, not what else
    found = dict(intersection_over_union(_by_group(rows), GROUPS)) if _whole(counts) else {}
    return found if movable is None else found | {GROUPS[MOVABLE]: movable}


def _whole(counts: NDArray[np.int64]) -> bool:
    """Tell whether more than boxes is labelled."""
    return not counts[UNLABELLED].any() or bool(counts[GROUP_OF_CLASS == GROUND].any())


def _by_group(rows: NDArray[np.int64]) -> NDArray[np.int64]:
    by_group = np.zeros((len(GROUPS), len(GROUPS)), np.int64)
    np.add.at(by_group, (GROUP_OF_CLASS[:, None], GROUP_OF_CLASS[None, :]), rows)
    return by_group


def scores(counts: NDArray[np.int64]) -> dict[str, float]:
    """Sum up class counts: ``movable``, ``ground``, ``other`` (terrain left out), the same with terrain, recall, precision, mIoUs."""
    without, whole = group_scores(counts, False), group_scores(counts, True)
    movable = GROUP_OF_CLASS == MOVABLE
    named = counts.copy()
    named[UNLABELLED] = 0
    by_class = intersection_over_union(named, [c.name for c in CLASSES]) if _whole(counts) else {}
    twelve = {CLASSES[i].name: by_class[CLASSES[i].name] for i in TWELVE if CLASSES[i].name in by_class}
    return {
        "movable": whole.get("movable", float("nan")),
        "ground": without.get("ground", float("nan")),
        "other": without.get("other", float("nan")),
        "ground_with_terrain": whole.get("ground", float("nan")),
        "other_with_terrain": whole.get("other", float("nan")),
        "recall_movable": float(counts[movable][:, movable].sum() / max(counts[movable].sum(), 1)),
        "precision_movable": float(counts[movable][:, movable].sum() / max(counts[:, movable].sum(), 1)),
        "miou": mean_iou({k: v for k, v in by_class.items() if k != "unlabelled"}) or float("nan"),
        "miou_12": mean_iou(twelve) or float("nan"),
    }


def score_table(network: LabellingNetwork, refs: Sequence[ScanRef]) -> Iterator[str]:
    """Score scan by scan and yield lines of a table, the last of them for all scans together.

    Each scan by itself, without what its neighbours see.
    """
    columns = list(scores(np.zeros((len(CLASSES), len(CLASSES)), np.int64)))
    yield "  ".join(["scan".ljust(12), *columns])
    counts = []
    for ref in refs:
        counts.append(count_scans(network, [ref]))
        yield _line(f"{sequence_of(ref)}/{ref.name}", columns, counts[-1])
    total = np.sum(counts, axis=0)
    yield _line("all", columns, total)
    by_class = intersection_over_union(total, [c.name for c in CLASSES])
    yield "  ".join(f"{name} {value:.3f}" for name, value in by_class.items() if name != "unlabelled")


def _line(name: str, columns: Sequence[str], counts: NDArray[np.int64]) -> str:
    found = scores(counts)
    return "  ".join([name.ljust(12), *(f"{found[c]:.4f}".rjust(len(c)) for c in columns)])
