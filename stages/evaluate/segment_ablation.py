"""What follows the network brings: class shares taken back, several scans, free space; scan by scan and together.

    python -m salpcc.stages.evaluate.segment_ablation --root DIR --out OUT 06=small
    python -m salpcc.stages.evaluate.segment_ablation --root DIR --out OUT 01,05,07=A.safetensors 00,04,09=B.safetensors

Every argument names sequences and the weights that label them: weights that never saw them, in a cross-validation.
The record ``ablations`` of OUT makes a table of ``salpcc-pipeline report``.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from salpcc.schemas.errors import SalpccError, UsageError
from salpcc.schemas.labels import CLASSES, GROUP_OF_CLASS, MOVABLE
from salpcc.schemas.manifest import expand_sequences
from salpcc.schemas.scan import Scan
from salpcc.stages.evaluate.measures.grid_frames import read_gops
from salpcc.stages.evaluate.report.record import record
from salpcc.stages.evaluate.report.schema import ABLATIONS
from salpcc.stages.ingest.stage import Projector
from salpcc.stages.lattice.sensor_model import load_sensor
from salpcc.stages.segment.checkpoint import load_cached
from salpcc.stages.segment.class_shares import as_in_streets
from salpcc.stages.segment.confusion import UNLABELLED, confusion
from salpcc.stages.segment.fused import FusedNetwork
from salpcc.stages.segment.labelling import joined
from salpcc.stages.segment.objects import judge_objects
from salpcc.stages.segment.registration import steps_between
from salpcc.stages.segment.segmenter import Segmentation, by_group, class_scores
from salpcc.stages.segment.several_scans import agree
from salpcc.stages.segment.training.score import scores
from salpcc.stages.segment.weights_file import weights_path

STUDY = "Segmentation: what follows the network"
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
FOUND = {"cars found": ("car",), "trucks, buses and the like found": ("truck", "other-vehicle")}
Counts = dict[str, NDArray[np.int64]]
_NONE = np.zeros((len(CLASSES), len(CLASSES)), np.int64)


def variants(
    network: FusedNetwork, gop: Sequence[tuple[int, Scan]]
) -> Iterator[tuple[str, list[Segmentation]]]:
    """Yield the name of each variant and what it makes of the scans of a group."""
    project = Projector(load_sensor("hdl64e"))
    sweeps = [project(number, scan) for number, scan in gop]
    found = [class_scores(network, scan.points, scan.intensity) for _, scan in gop]
    yield "as trained, scan by scan", [by_group(*one) for one in found]
    weighed = [by_group(image, as_in_streets(scores)) for image, scores in found]
    yield "class shares taken back, scan by scan", weighed
    steps = steps_between(weighed, joined(sweeps), [sweep.motion for sweep in sweeps])
    yield "the same, several scans", agree(weighed, steps, free_space=False)
    agreed = agree(weighed, steps)
    yield "the same, free space as well", agreed
    yield "class shares taken back, objects, scan by scan", judge_objects(weighed, [None] * len(steps))
    yield "several scans, free space, objects (default)", judge_objects(agreed, steps)


def study(
    root: Path, folds: Sequence[tuple[str, Path]], log: Callable[[str], None] = print
) -> list[dict[str, Any]]:
    """Return ABLATIONS rows of some sequences, each labelled by the weights beside it, and of all together."""
    rows: list[dict[str, Any]] = []
    every: Counts = {}
    for names, weights in folds:
        network = load_cached(weights)
        for sequence in expand_sequences(names):
            counts: Counts = {}
            for gop in read_gops(root, sequence):
                for variant, found in variants(network, gop):
                    for one, (_, scan) in zip(found, gop, strict=True):
                        some = _counts(one, scan)
                        counts[variant] = counts.get(variant, _NONE) + some
                        every[variant] = every.get(variant, _NONE) + some
            rows += _rows(sequence, counts)
            log(f"{sequence}: done")
    return rows if len({row["sequence"] for row in rows}) == 1 else rows + _rows("all", every)


def _counts(found: Segmentation, scan: Scan) -> NDArray[np.int64]:
    assert scan.classes is not None
    known = scan.classes != UNLABELLED
    return confusion(scan.classes[known], found.labels()[known], len(CLASSES))


def _rows(sequence: str, counts: Counts) -> list[dict[str, Any]]:
    rows = []
    for variant, count in counts.items():
        found = scores(count)
        values = {name: found[key] for key, name in MEASURES.items()} | _found(count)
        rows += [
            {"study": STUDY, "sequence": sequence, "variant": variant, "measure": name, "value": value}
            for name, value in values.items()
        ]
    return rows


def _found(count: NDArray[np.int64]) -> dict[str, float]:
    by_group = count[:, GROUP_OF_CLASS == MOVABLE].sum(axis=1)
    shares = {}
    for name, classes in FOUND.items():
        rows = [i for i, c in enumerate(CLASSES) if c.name in classes]
        points = count[rows].sum()
        shares[name] = float(by_group[rows].sum() / points) if points else float("nan")
    return shares


def _fold(text: str) -> tuple[str, Path]:
    names, _, weights = text.partition("=")
    if not weights:
        raise UsageError(f"{text}: SEQUENCES=WEIGHTS is wanted, such as 06=small")
    return names, weights_path(weights)


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure, write the record ``ablations`` of OUT, print it."""
    parser = argparse.ArgumentParser(description=STUDY)
    parser.add_argument("folds", nargs="+", metavar="SEQUENCES=WEIGHTS")
    parser.add_argument("--root", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args(arguments)
    try:
        rows = study(options.root, [_fold(text) for text in options.folds])
    except SalpccError as error:
        parser.error(str(error))
    record(options.out, ablations=pa.Table.from_pylist(rows, schema=ABLATIONS))
    for start in range(0, len(rows), len(MEASURES) + len(FOUND)):
        part = rows[start : start + len(MEASURES) + len(FOUND)]
        values = "  ".join(f"{row['value']:.3f}" for row in part)
        print(f"{part[0]['sequence']:4} {part[0]['variant']:40} {values}")


if __name__ == "__main__":
    main()
