"""Labelled range images, read from disk as they are asked for, with a bounded memory of the last ones.

Labels may be partial: what is 0 teaches nothing, and of what SemanticKITTI calls other-structure or other-object (52,
99) no class is known but that it is not movable.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from salpcc.schemas.errors import SourceError
from salpcc.schemas.labels import CLASSES, classes_of_labels
from salpcc.schemas.work import ScanRef
from salpcc.stages.ingest.sources.semantickitti import SemanticKitti, read_labels
from salpcc.stages.segment.network.projection import project
from salpcc.stages.segment.network.range_image import RANGE
from salpcc.stages.segment.training.kitti_boxes import HINT, labels_of_boxes, list_boxed

F32 = NDArray[np.float32]

NOT_MOVABLE = len(CLASSES)  # beside the classes: of whatever class that is not movable
_NOT_MOVABLE_IDS = (52, 99)


@dataclass(frozen=True, eq=False)
class LabelledImage:
    """A labelled scan on the grid.

    Attributes:
        planes: ``(6, 64, W)`` float32, as in :class:`~salpcc.stages.segment.network.range_image.RangeImage`.
        classes: ``(64, W)`` uint8, 0 where unlabelled or empty, NOT_MOVABLE where no more is known.
        instances: ``(64, W)`` uint32, the raw label (instance and class) of pixels of one thing whose class is known, else 0.
    """

    planes: F32
    classes: NDArray[np.uint8]
    instances: NDArray[np.uint32]

    @cached_property
    def labelled(self) -> float:
        """Share of the returns that are labelled."""
        return float((self.classes > 0).sum() / max((self.planes[RANGE] > 0).sum(), 1))


def list_labelled(root: Path, taught: bool = False) -> list[ScanRef]:
    """List the labelled scans of a root in the layout of SemanticKITTI, of KITTI's objects or of its tracking.

    Args:
        taught: a teacher is at hand, so a root without any labels will do, too.

    Raises:
        SourceError: nothing is labelled.
    """
    source = SemanticKitti()
    every = [ref for sequence in source.sequences(root) for ref in source.scans(root, sequence)]
    refs = [ref for ref in every if ref.labels is not None] + list_boxed(root)
    if not refs and taught:
        refs = every
    if not refs:
        raise SourceError(f"{root}: no labelled scans. {source.hint}; or {HINT}")
    return refs


def split_labelled(
    roots: Sequence[Path], names: Sequence[str], taught: bool = False
) -> tuple[list[ScanRef], list[ScanRef]]:
    """List the labelled scans of some roots: those to train on, and those held out, by sequence or ``SEQUENCE/SCAN``.

    ``taught`` as in :func:`list_labelled`.

    Raises:
        SourceError: a root has no labelled scans, or nothing has such a name.
    """
    rest: list[ScanRef] = []
    held: list[ScanRef] = []
    unmet = set(names)
    for ref in (ref for root in roots for ref in list_labelled(root, taught)):
        met = {sequence_of(ref), f"{sequence_of(ref)}/{ref.name}"} & set(names)
        unmet -= met
        (held if met else rest).append(ref)
    where = ", ".join(map(str, roots))
    if unmet:
        raise SourceError(f"{where}: no labelled scans of {', '.join(sorted(unmet))}")
    return rest, held


def sequence_of(ref: ScanRef) -> str:
    """Name of the sequence that a labelled scan belongs to; ``training`` of KITTI's objects."""
    folder = Path(ref.path).parent
    return folder.parent.name if folder.name == "velodyne" else folder.name


def consecutive(refs: Sequence[ScanRef], most: int) -> Iterator[list[ScanRef]]:
    """Cut scans into groups of at most ``most`` whose frames follow each other in one sequence."""
    group: list[ScanRef] = []
    for ref in refs:
        follows = group and (sequence_of(ref), ref.number) == (sequence_of(group[-1]), group[-1].number + 1)
        if group and (not follows or len(group) == most):
            yield group
            group = []
        group.append(ref)
    if group:
        yield group


def raw_labels(ref: ScanRef, points: F32) -> NDArray[np.uint32]:
    """Return the label ``(N,)`` of each point ``(N, 3)`` as SemanticKITTI writes it, of a file or from boxes; 0 where there are none.

    Raises:
        SourceError: the file is unreadable, not one label a point, or not what the layout says.
    """
    if ref.labels is None:
        return np.zeros(len(points), np.uint32)
    if ref.labels.endswith(".txt"):
        return labels_of_boxes(ref, points)
    return read_labels(ref, len(points))


def not_movable(labels: NDArray[np.uint32]) -> NDArray[np.bool_]:
    """Tell which raw labels ``(N,)`` say that a point is not movable, and no more."""
    return np.isin(labels & 0xFFFF, _NOT_MOVABLE_IDS)


def read_labelled(ref: ScanRef) -> LabelledImage:
    """Read a scan and its labels onto the grid.

    Raises:
        SourceError: as the source's ``read``.
    """
    scan = SemanticKitti().read(ref, with_labels=False)
    labels = raw_labels(ref, scan.points)
    known = classes_of_labels(labels)
    known[not_movable(labels)] = NOT_MOVABLE
    image = project(scan.points, scan.intensity)
    seen = image.index >= 0
    shown = image.index[seen]
    classes = np.zeros(image.index.shape, np.uint8)
    classes[seen] = known[shown]
    instances = np.zeros(image.index.shape, np.uint32)
    instances[seen] = labels[shown]
    instances[(instances >> 16 == 0) | (classes == 0) | (classes == NOT_MOVABLE)] = 0
    return LabelledImage(image.planes, classes, instances)


class LabelledScans:
    """Scans by number; the last ``memory`` of them stay in memory (4 MB each)."""

    def __init__(self, refs: Sequence[ScanRef], memory: int = 400) -> None:
        self.refs = list(refs)
        self._memory = memory
        self._kept: OrderedDict[int, LabelledImage] = OrderedDict()

    def __len__(self) -> int:
        return len(self.refs)

    def __getitem__(self, number: int) -> LabelledImage:
        found = self._kept.get(number)
        if found is None:
            found = read_labelled(self.refs[number])
            self._kept[number] = found
            if len(self._kept) > self._memory:
                self._kept.popitem(last=False)
        else:
            self._kept.move_to_end(number)
        return found
