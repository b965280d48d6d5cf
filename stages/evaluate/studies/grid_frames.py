"""Frames of the paper profile as its residual coders see them, for studies of prediction and coding."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from salpcc.schemas.config import RunConfig
from salpcc.schemas.grid import GridPrediction, GridSweep
from salpcc.schemas.grid_shards import (
    table_to_grid_predictions,
    table_to_grids,
    table_to_planes,
)
from salpcc.schemas.scan import Scan
from salpcc.stages.coding import code
from salpcc.stages.ground_fit.grid_planes import ground_of
from salpcc.stages.ingest.sources.semantickitti import SemanticKitti
from salpcc.stages.residual_code.paper.grid_streams import images_of
from salpcc.stages.residual_code.paper.image_coder import Images


@dataclass(frozen=True, eq=False)
class Frame:
    """One frame: its grid sweep, its planes ``(P, 4)``, what is predicted, and which cells are ground."""

    sweep: GridSweep
    planes: NDArray[np.int32]
    predicted: GridPrediction
    ground: NDArray[np.bool_]

    @property
    def images(self) -> Images:
        """What the coder of the frame knows before it."""
        return images_of(self.planes, self.predicted, self.sweep.elevation, self.sweep.accuracy)


def read_gops(root: Path, sequence: str, size: int = 8) -> Iterator[list[tuple[int, Scan]]]:
    """Read a labelled sequence of SemanticKITTI in groups of consecutive scans, each with its frame number."""
    source = SemanticKitti()
    group: list[tuple[int, Scan]] = []
    for ref in source.scans(root, sequence):
        if group and (len(group) == size or ref.number != group[-1][0] + 1):
            yield group
            group = []
        group.append((ref.number, source.read(ref, with_labels=True)))
    if group:
        yield group


def paper_frames(scans: Sequence[tuple[int, Scan]], accuracy: float) -> list[Frame]:
    """Take a GOP of labelled scans through the stages of the paper profile up to prediction; movables are dropped."""
    config = RunConfig.model_validate({"profile": "paper", "max_error": accuracy, "labels": "given"})
    made = code(scans, config, last="predict")
    predictions = table_to_grid_predictions(made["predict"])
    return [
        Frame(sweep, fitted, predicted, ground_of(sweep))
        for sweep, fitted, predicted in zip(
            table_to_grids(made["segment"]), table_to_planes(made["ground_fit"]), predictions, strict=True
        )
    ]
