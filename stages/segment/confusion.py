"""Segmentation measures: confusion matrices, IoU and mIoU, eqs. (21) and (22).

Points that the labels leave unlabelled are not counted, as SemanticKITTI does. The mean is over the
classes that occur in the truth or in the prediction: with a few scans an absent class says nothing.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from salpcc.schemas.labels import CLASSES, GROUPS, OTHER

UNLABELLED = 0
_GROUND_UNSPECIFIED = len(CLASSES) - 1
# The classes of the paper's Table I: those of its movable and ground groups.
PAPER_CLASSES = tuple(c.name for c in CLASSES if c.group != OTHER and c.ids)


def confusion(truth: NDArray[np.uint8], predicted: NDArray[np.uint8], size: int) -> NDArray[np.int64]:
    """Count ``(size, size)`` pairs, truth by row. Both inputs are ``(N,)`` indices below ``size``."""
    pairs = truth.astype(np.int64) * size + predicted
    return np.bincount(pairs, minlength=size * size).reshape(size, size)


def group_counts(truth: NDArray[np.uint8], groups: NDArray[np.uint8]) -> NDArray[np.int64]:
    """Count ``(21, 3)``: class of the truth ``(N,)`` by row, predicted group ``(N,)`` by column."""
    labelled = truth != UNLABELLED
    pairs = truth[labelled].astype(np.int64) * len(GROUPS) + groups[labelled]
    return np.bincount(pairs, minlength=len(CLASSES) * len(GROUPS)).reshape(len(CLASSES), len(GROUPS))


def group_confusion(counts: NDArray[np.int64], without: Collection[str] = ()) -> NDArray[np.int64]:
    """Add :func:`group_counts` up to ``(3, 3)``, groups of the truth by row, ``without`` points of some classes."""
    result = np.zeros((len(GROUPS), len(GROUPS)), np.int64)
    for row, named in zip(counts, CLASSES, strict=True):
        if named.name not in without:
            result[named.group] += row
    return result


def class_confusion(truth: NDArray[np.uint8], predicted: NDArray[np.uint8]) -> NDArray[np.int64] | None:
    """Count the classes, or None where the segmenter knows groups only (it says the class ``ground``)."""
    if (predicted == _GROUND_UNSPECIFIED).any():
        return None
    labelled = truth != UNLABELLED
    return confusion(truth[labelled], predicted[labelled], len(CLASSES))


def intersection_over_union(counts: NDArray[np.int64], names: Sequence[str]) -> Mapping[str, float]:
    """IoU, eq. (21), from counts ``(C, C)``, of each class that occurs in the truth or in the prediction."""
    hit = np.diag(counts)
    union = counts.sum(axis=0) + counts.sum(axis=1) - hit
    return {name: float(hit[i] / union[i]) for i, name in enumerate(names) if union[i] > 0}


def mean_iou(scores: Mapping[str, float]) -> float | None:
    """Return mIoU, eq. (22), or None where there is no class to average."""
    return float(np.mean(list(scores.values()))) if scores else None
