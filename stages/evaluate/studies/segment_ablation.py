"""What follows the network brings: several scans, free space, objects; scan by scan and together.

    python -m salpcc.stages.evaluate.studies.segment_ablation --root DIR --out OUT 06=small
    python -m salpcc.stages.evaluate.studies.segment_ablation --root DIR --out OUT 01,05,07=A.safetensors 00,04,09=B.safetensors

Every argument names sequences and the weights that label them: weights that never saw them, in a cross-validation.
The record ``ablations`` of OUT makes a table of ``salpcc-pipeline report``.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import groupby
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from salpcc.schemas.errors import SalpccError, UsageError
from salpcc.schemas.labels import CLASSES, GROUP_OF_CLASS, MOVABLE, classes_of_labels
from salpcc.schemas.manifest import expand_sequences
from salpcc.schemas.scan import Scan
from salpcc.stages.evaluate.report.record import record
from salpcc.stages.evaluate.report.schema import ABLATIONS
from salpcc.stages.evaluate.studies.reliability import BINS, calibration_error, reliability
from salpcc.stages.ingest.sources.semantickitti import SemanticKitti
from salpcc.stages.ingest.stage import Projector
from salpcc.stages.lattice.sensor_model import load_sensor
from salpcc.stages.segment.confusion import UNLABELLED
from salpcc.stages.segment.labelling import joined
from salpcc.stages.segment.network.checkpoint import load_cached
from salpcc.stages.segment.network.projection import project
from salpcc.stages.segment.network.quantised import LabellingNetwork
from salpcc.stages.segment.objects import judge_objects
from salpcc.stages.segment.registration import steps_between
from salpcc.stages.segment.segmenter import Segmentation, segment_image
from salpcc.stages.segment.several_scans import agree
from salpcc.stages.segment.training.labelled import consecutive, not_movable, raw_labels, split_labelled
from salpcc.stages.segment.training.score import count, scores
from salpcc.stages.segment.weights_file import weights_path

STUDY = "Segmentation: what follows the network"
CALIBRATION = "Segmentation: how many of the pixels said to be movable are"
MEASURES = {
    "movable": "movable",
    "ground": "ground",
    "other": "other",
    "ground_with_terrain": "ground, with terrain",
    "other_with_terrain": "other, with terrain",
    "recall_movable": "movable, recall",
    "precision_movable": "movable, precision",
    "miou": "mIoU, 19 classes",
    "miou_12": "mIoU, the paper's classes",
}
# Of the points of these classes, the share that is called movable, as whatever vehicle.
FOUND = {
    "cars found": ("car",),
    "trucks, buses and the like found": ("truck", "other-vehicle"),
    "people found": ("person",),
    "two-wheelers found": ("bicycle", "motorcycle", "bicyclist", "motorcyclist"),
}
_GOP = 8


@dataclass
class Sums:
    """Of one variant: classes ``(21, 21)`` by truth and finding, and :func:`reliability` ``(10, 3)``."""

    classes: NDArray[np.int64] = field(
        default_factory=lambda: np.zeros((len(CLASSES), len(CLASSES)), np.int64)
    )
    said: NDArray[np.float64] = field(default_factory=lambda: np.zeros((BINS, 3)))

    def add(self, found: Segmentation, labels: NDArray[np.uint32]) -> None:
        """Count what is found in a scan against its raw labels ``(N,)``."""
        self.classes += count(labels, found.labels())
        truth = classes_of_labels(labels)
        movable = GROUP_OF_CLASS[truth] == MOVABLE
        self.said += reliability(found, (truth != UNLABELLED) | not_movable(labels), movable)


def groups(root: Path, sequence: str) -> Iterator[list[tuple[int, Scan, NDArray[np.uint32]]]]:
    """Read a labelled sequence in groups of consecutive scans: frame number, scan and raw labels of each.

    Raises:
        SourceError: the sequence is not there, or has no labels.
    """
    for group in consecutive(split_labelled([root], [sequence])[1], _GOP):
        read = [(ref, SemanticKitti().read(ref, with_labels=False)) for ref in group]
        yield [(ref.number, scan, raw_labels(ref, scan.points)) for ref, scan in read]


def variants(
    network: LabellingNetwork, gop: Sequence[tuple[int, Scan]]
) -> Iterator[tuple[str, list[Segmentation]]]:
    """Yield the name of each variant and what it makes of the scans of a group."""
    to_sweep = Projector(load_sensor("hdl64e"))
    sweeps = [to_sweep(number, scan) for number, scan in gop]
    found = [segment_image(network, project(scan.points, scan.intensity)) for _, scan in gop]
    yield "scan by scan", found
    steps = steps_between(found, joined(sweeps), [sweep.motion for sweep in sweeps])
    yield "several scans", agree(found, steps, free_space=False)
    agreed = agree(found, steps)
    yield "several scans, free space", agreed
    yield "objects, scan by scan", judge_objects(found, [None] * len(steps))
    yield "several scans, free space, objects (default)", judge_objects(agreed, steps)


def study(
    root: Path, folds: Sequence[tuple[str, Path]], log: Callable[[str], None] = print
) -> list[dict[str, Any]]:
    """Return ABLATIONS rows of some sequences, each labelled by the weights beside it, and of all together."""
    rows: list[dict[str, Any]] = []
    every: dict[str, Sums] = {}
    for names, weights in folds:
        network = load_cached(weights)
        for sequence in expand_sequences(names):
            sums: dict[str, Sums] = {}
            for group in groups(root, sequence):
                for variant, found in variants(network, [(number, scan) for number, scan, _ in group]):
                    for one, (_, _, labels) in zip(found, group, strict=True):
                        for total in (sums, every):
                            total.setdefault(variant, Sums()).add(one, labels)
            rows += _rows(sequence, sums)
            log(f"{sequence}: done")
    return rows if len({row["sequence"] for row in rows}) == 1 else rows + _rows("all", every)


def _rows(sequence: str, sums: dict[str, Sums]) -> list[dict[str, Any]]:
    rows = []
    for variant, one in sums.items():
        found = scores(one.classes)
        values = {name: found[key] for key, name in MEASURES.items()} | _found(one.classes)
        said = {"calibration error": calibration_error(one.said)} | {
            f"of {k / BINS:.1f} to {(k + 1) / BINS:.1f}": true / pixels if pixels else float("nan")
            for k, (_, true, pixels) in enumerate(one.said)
        }
        rows += [
            {"study": study, "sequence": sequence, "variant": variant, "measure": name, "value": value}
            for study, measures in ((STUDY, values), (CALIBRATION, said))
            for name, value in measures.items()
        ]
    return rows


def _found(counts: NDArray[np.int64]) -> dict[str, float]:
    by_group = counts[:, GROUP_OF_CLASS == MOVABLE].sum(axis=1)
    shares = {}
    for name, classes in FOUND.items():
        rows = [i for i, c in enumerate(CLASSES) if c.name in classes]
        points = counts[rows].sum()
        shares[name] = float(by_group[rows].sum() / points) if points else float("nan")
    return shares


def folds_of(texts: Sequence[str]) -> list[tuple[str, Path]]:
    """Return sequences and weights of folds written as ``SEQUENCES=WEIGHTS``.

    Raises:
        UsageError: one is written otherwise.
        WeightsError: weights cannot be had.
    """
    folds = []
    for text in texts:
        names, _, weights = text.partition("=")
        if not weights:
            raise UsageError(f"{text}: SEQUENCES=WEIGHTS is wanted, such as 06=small")
        folds.append((names, weights_path(weights)))
    return folds


def run_study(
    title: str,
    study: Callable[[Path, Sequence[tuple[str, Path]]], list[dict[str, Any]]],
    arguments: Sequence[str] | None = None,
) -> None:
    """Measure what the command line names, write the record ``ablations`` of OUT, print it."""
    parser = argparse.ArgumentParser(description=title)
    parser.add_argument("folds", nargs="+", metavar="SEQUENCES=WEIGHTS")
    parser.add_argument("--root", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args(arguments)
    try:
        rows = study(options.root, folds_of(options.folds))
    except SalpccError as error:
        parser.error(str(error))
    record(options.out, ablations=pa.Table.from_pylist(rows, schema=ABLATIONS))
    for (sequence, variant, _), part in groupby(rows, itemgetter("sequence", "variant", "study")):
        print(f"{sequence:4} {variant:40} " + "  ".join(f"{row['value']:.3f}" for row in part))


if __name__ == "__main__":
    run_study(STUDY, study)
