"""What is found in scans as other sensors would have made them: fewer rings and firings, counts, no intensities, another height.

    python -m salpcc.stages.evaluate.studies.segment_sensors --root DIR --out OUT 06=small

Points are taken from recorded scans, so their labels hold. The record ``ablations`` of OUT makes a table of
``salpcc-pipeline report``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

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
_FIRINGS = 1024  # a turn
_HIGHER = 0.8  # metres


def _as_it_is(
    scan: Scan, row: NDArray[np.int32], firing: NDArray[np.int64]
) -> tuple[Scan, NDArray[np.bool_]]:
    return scan, row >= 0


def _rings(every: int, firings: int = 1) -> Callable[..., tuple[Scan, NDArray[np.bool_]]]:
    return lambda scan, row, firing: (scan, (row % every == 0) & (row >= 0) & (firing % firings == 0))


def _counts(scan: Scan, row: NDArray[np.int32], firing: NDArray[np.int64]) -> tuple[Scan, NDArray[np.bool_]]:
    return replace(scan, intensity=255 * scan.intensity), row >= 0


def _unlit(scan: Scan, row: NDArray[np.int32], firing: NDArray[np.int64]) -> tuple[Scan, NDArray[np.bool_]]:
    return replace(scan, intensity=np.zeros_like(scan.intensity)), row >= 0


def _higher(scan: Scan, row: NDArray[np.int32], firing: NDArray[np.int64]) -> tuple[Scan, NDArray[np.bool_]]:
    return replace(scan, points=scan.points - np.array([0, 0, _HIGHER], np.float32)), row >= 0


SENSORS = {
    "as recorded, 64 rings": _as_it_is,
    "intensities as counts": _counts,
    "no intensities": _unlit,
    "ground 0.8 m lower": _higher,
    "64 rings, 1,024 firings a turn": _rings(1, 2),
    "32 rings": _rings(2),
    "22 rings, 1,024 firings a turn": _rings(3, 2),
    "16 rings": _rings(4),
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
    scans, truths = [], []
    for _, scan, labels in group:
        row = project(scan.points, scan.intensity).row
        firing = np.floor(np.arctan2(scan.points[:, 1], scan.points[:, 0]) * (_FIRINGS / np.pi)).astype(
            np.int64
        )
        seen, kept = SENSORS[sensor](scan, row, firing)
        scans.append(Scan(seen.name, seen.points[kept], seen.intensity[kept], seen.time))
        truths.append(labels[kept])
    found = network_classes(scans, joined(scans), [None] * len(scans), str(weights))
    return np.sum([count(truth, classes) for truth, classes in zip(truths, found, strict=True)], axis=0)


def _rows(sequence: str, totals: dict[str, NDArray[np.int64]]) -> list[dict[str, Any]]:
    return [
        {"study": STUDY, "sequence": sequence, "variant": sensor, "measure": name, "value": value}
        for sensor, total in totals.items()
        for key, name in MEASURES.items()
        for value in [scores(total)[key]]
    ]


if __name__ == "__main__":
    run_study(STUDY, study)
