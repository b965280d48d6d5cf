"""What is found in scans as other sensors would have made them: fewer rings and firings, counts, no intensities, another height.

    python -m salpcc.stages.evaluate.studies.segment_sensors --root DIR --out OUT 06=small

Points are taken from recorded scans, so their labels hold. The record ``ablations`` of OUT makes a table of
``salpcc-pipeline report``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from salpcc.schemas.labels import CLASSES
from salpcc.schemas.manifest import expand_sequences
from salpcc.schemas.scan import Scan
from salpcc.stages.evaluate.studies.segment_ablation import MEASURES, groups, run_study
from salpcc.stages.segment.labelling import joined, network_classes
from salpcc.stages.segment.network.projection import project
from salpcc.stages.segment.training.score import count, scores

STUDY = "Segmentation: scans as other sensors would have made them"
_FIRINGS = 1024  # a turn, of those that take every second one


class Sensor(NamedTuple):
    """What of a recorded scan another sensor would have seen.

    Attributes:
        rings, firings: one row of so many, and one firing of so many.
        unit: what an intensity of 1 is.
        higher: metres that it rides higher.
    """

    rings: int = 1
    firings: int = 1
    unit: float = 1.0
    higher: float = 0.0


SENSORS = {
    "as recorded, 64 rings": Sensor(),
    "intensities as counts": Sensor(unit=255),
    "no intensities": Sensor(unit=0),
    "ground 0.8 m lower": Sensor(higher=0.8),
    "64 rings, 1,024 firings a turn": Sensor(firings=2),
    "32 rings": Sensor(rings=2),
    "22 rings, 1,024 firings a turn": Sensor(rings=3, firings=2),
    "16 rings": Sensor(rings=4),
}


def study(
    root: Path, folds: Sequence[tuple[str, Path]], log: Callable[[str], None] = print
) -> list[dict[str, Any]]:
    """Return ABLATIONS rows of some sequences, each labelled by the weights beside it, and of all together."""
    rows: list[dict[str, Any]] = []
    every = {sensor: np.zeros((len(CLASSES), len(CLASSES)), np.int64) for sensor in SENSORS}
    for names, weights in folds:
        for sequence in expand_sequences(names):
            own = {sensor: np.zeros_like(total) for sensor, total in every.items()}
            for group in groups(root, sequence):
                for sensor in SENSORS:
                    own[sensor] += count_seen(sensor, group, weights)
            for sensor, total in own.items():
                every[sensor] += total
            rows += _rows(sequence, own)
            log(f"{sequence}: done")
    return rows if len({row["sequence"] for row in rows}) == 1 else rows + _rows("all", every)


def count_seen(
    sensor: str, group: Sequence[tuple[int, Scan, NDArray[np.uint32]]], weights: Path
) -> NDArray[np.int64]:
    """Return classes ``(21, 21)`` by truth and finding of a group's scans, as a sensor of :data:`SENSORS` would have seen them."""
    seen, scans, truths = SENSORS[sensor], [], []
    for _, scan, labels in group:
        row = project(scan.points, scan.intensity).row
        turned = np.arctan2(scan.points[:, 1], scan.points[:, 0]) * (_FIRINGS / np.pi)
        kept = (row >= 0) & (row % seen.rings == 0) & (np.floor(turned).astype(np.int64) % seen.firings == 0)
        points = scan.points[kept] - np.array([0, 0, seen.higher], np.float32)
        scans.append(Scan(scan.name, points, scan.intensity[kept] * np.float32(seen.unit), scan.time))
        truths.append(labels[kept])
    found = network_classes(scans, joined(scans), [None] * len(scans), str(weights))
    return np.sum([count(truth, classes) for truth, classes in zip(truths, found, strict=True)], axis=0)


def _rows(sequence: str, totals: dict[str, NDArray[np.int64]]) -> list[dict[str, Any]]:
    found = {sensor: scores(total) for sensor, total in totals.items()}
    return [
        {"study": STUDY, "sequence": sequence, "variant": sensor, "measure": name, "value": own[key]}
        for sensor, own in found.items()
        for key, name in MEASURES.items()
    ]


if __name__ == "__main__":
    run_study(STUDY, study)
