"""Labelled range images, read from disk as they are asked for, with a bounded memory of the last ones."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from salpcc.schemas.errors import SourceError
from salpcc.schemas.labels import GROUP_OF_CLASS, MOVABLE
from salpcc.schemas.work import ScanRef
from salpcc.stages.ingest.sources.semantickitti import SemanticKitti
from salpcc.stages.segment.range_image import project

F32 = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class LabelledImage:
    """A labelled scan on the grid.

    Attributes:
        planes: ``(6, 64, W)`` float32, as in :class:`~salpcc.stages.segment.range_image.RangeImage`.
        classes: ``(64, W)`` uint8, 0 where unlabelled or empty.
        instances: ``(64, W)`` uint32, the raw label (instance and class) of movable pixels, else 0.
    """

    planes: F32
    classes: NDArray[np.uint8]
    instances: NDArray[np.uint32]


def list_labelled(
    root: Path, sequences: Sequence[str] | None = None, leave_out: Sequence[str] = ()
) -> list[ScanRef]:
    """List the labelled scans of a SemanticKITTI-layout root.

    Raises:
        SourceError: a sequence is missing, or nothing is labelled.
    """
    source = SemanticKitti()
    chosen = [s for s in sequences or source.sequences(root) if s not in leave_out]
    refs = [ref for sequence in chosen for ref in source.scans(root, sequence) if ref.labels is not None]
    if not refs:
        raise SourceError(f"{root}: no labelled scans ({', '.join(chosen) or 'no sequences'}). {source.hint}")
    return refs


def sequence_of(ref: ScanRef) -> str:
    """Name of the sequence that a scan in SemanticKITTI layout belongs to."""
    return Path(ref.path).parent.parent.name


def read_labelled(ref: ScanRef) -> LabelledImage:
    """Read a scan and its labels onto the grid.

    Raises:
        SourceError: as the source's ``read``.
    """
    scan = SemanticKitti().read(ref, with_labels=True)
    assert scan.classes is not None and ref.labels is not None
    image = project(scan.points, scan.intensity)
    seen = image.index >= 0
    shown = image.index[seen]
    classes = np.zeros(image.index.shape, np.uint8)
    classes[seen] = scan.classes[shown]
    instances = np.zeros(image.index.shape, np.uint32)
    instances[seen] = np.fromfile(ref.labels, "<u4")[shown]
    instances[GROUP_OF_CLASS[classes] != MOVABLE] = 0
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
