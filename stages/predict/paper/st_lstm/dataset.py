"""Clips to train on: consecutive real and simulated scans as the decoder would have them, ready for the network."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from salpcc.schemas.labels import GROUP_OF_CLASS, MOVABLE
from salpcc.schemas.scan import Scan
from salpcc.schemas.work import ScanRef
from salpcc.stages.ingest.paper_grid import ELEVATION_UNIT, directions, nearest_of_cells, row_elevations
from salpcc.stages.ingest.sources import SOURCES
from salpcc.stages.ingest.sources.base import Source
from salpcc.stages.lattice.motion_search import is_raw, solve_motion
from salpcc.stages.predict.paper.motion import UNITS, find_motion
from salpcc.stages.predict.paper.st_lstm.inputs import Inputs, gather
from salpcc.stages.predict.paper.st_lstm.warp import F64, Image, after, pose_of, warp

_ACCURACY = 0.001  # metres


@dataclass(frozen=True, eq=False)
class Clip:
    """Consecutive frames of one drive.

    Attributes:
        name: of the sequence.
        frames: ``(64, 2000)`` int32 mm each, movables left out where labels tell.
        elevation: ``(64,)`` float64 radians of the rows.
        motions: ``(6,)`` float64 from each frame to the next; None where none was found.
        inputs: of each frame but the first; the error of the last prediction is still missing in them.
    """

    name: str
    frames: list[Image]
    elevation: F64
    motions: list[F64 | None]
    inputs: list[Inputs]


def read_clips(root: Path) -> Iterator[Clip]:
    """Read every run of consecutive scans, two or more, of every source below ``root``."""
    for source in (
        SOURCES["semantickitti"],
        SOURCES["kitti_raw"],
    ):  # simulated drives have the first's layout
        for sequence in source.sequences(root):
            for run in _runs(source.scans(root, sequence)):
                if len(run) > 1:
                    yield make_clip(sequence, [_read(source, reference) for reference in run])


def _runs(references: Sequence[ScanRef]) -> Iterator[list[ScanRef]]:
    run: list[ScanRef] = []
    for reference in references:
        if run and reference.number != run[-1].number + 1:
            yield run
            run = []
        run.append(reference)
    yield run


def _read(source: Source, reference: ScanRef) -> Scan:
    return source.read(reference, with_labels=reference.labels is not None)


def make_clip(name: str, scans: Sequence[Scan]) -> Clip:
    """Put scans on the grid, register them, and make the inputs of every step."""
    points = [_kept(scan) for scan in scans]
    elevation = row_elevations(points)
    beams = directions(elevation)
    rows: F64 = elevation.astype(np.float64) * ELEVATION_UNIT
    frames = [nearest_of_cells(some, _ACCURACY)[1] for some in points]
    motions: list[F64 | None] = []
    inputs: list[Inputs] = []
    guess: F64 | None = None
    for number in range(1, len(frames)):
        last, new = frames[number - 1], frames[number]
        whole = scans[number].points
        if not is_raw(whole):
            guess = solve_motion(whole, guess)
        moving, fixed = (beams * (image.reshape(-1, 1) * _ACCURACY) for image in (last, new))
        found = find_motion(moving, fixed, guess)
        motions.append(None if found is None else found * UNITS)
        if is_raw(whole):
            guess = motions[-1]
        pose = _pose(motions[-1])
        base, status = warp(last, pose, rows)
        before = np.zeros_like(last)
        if number > 1:
            before = warp(frames[number - 2], after(pose, _pose(motions[-2])), rows)[0]
        inputs.append(gather(base, status, last, before, np.zeros_like(last)))
    return Clip(name, frames, rows, motions, inputs)


def _kept(scan: Scan) -> NDArray[np.float32]:
    if scan.classes is None:
        return scan.points
    return scan.points[GROUP_OF_CLASS[scan.classes] != MOVABLE]


def _pose(motion: F64 | None) -> F64:
    return pose_of(np.zeros(6) if motion is None else motion)
