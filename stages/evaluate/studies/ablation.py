"""What each prediction of the paper profile brings: bits of the residuals without and with it.

    python -m salpcc.stages.evaluate.studies.ablation --root DIR --sequences 04,06 --out OUT

Variants: (a) nothing is predicted, levels are coded as they are; (b) the range in the same cell of the last frame;
(b2) the last frame warped by the motion; (c) planes for ground, (b) for the rest; (d) the network for the rest, (b) for
ground; (e) planes and network. Only frames with one before them count. In (b) to (e) a cell that a prediction does not
reach takes that of its neighbours.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from salpcc.stages.evaluate.report.record import record
from salpcc.stages.evaluate.report.schema import ABLATIONS
from salpcc.stages.evaluate.studies.grid_frames import Frame, paper_frames, read_gops
from salpcc.stages.ingest.paper_grid import ELEVATION_UNIT
from salpcc.stages.predict.paper.motion import UNITS
from salpcc.stages.residual_code.paper.grid_context import ContextImages
from salpcc.stages.residual_code.paper.grid_residuals import ground_first, residuals, to_symbols
from salpcc.stages.residual_code.paper.image_coder import Images
from salpcc.stages.residual_code.paper.lossless import CODERS

STUDY = "What prediction brings (paper profile)"
VARIANTS = {
    "a": "(a) no prediction",
    "b": "(b) last frame",
    "b2": "(b2) last frame, warped",
    "c": "(c) planes for ground",
    "d": "(d) ST-LSTM for the rest",
    "e": "(e) planes and ST-LSTM",
}
MEASURES = {"ppmd": "PPMd, bits per return", "context": "context coder, bits per return"}
Bits = dict[tuple[str, str], int]


def frame_bits(frame: Frame, last: Frame) -> Bits:
    """Bits of the levels of one frame by variant and coder; planes are not counted, they cost 0.05 bits a return."""
    images, level, ground = frame.images, frame.sweep.level, frame.ground
    unmoved, nothing = last.sweep.level, np.zeros_like(level)
    warped = _warped(frame, last)
    network = images.frame
    given = {
        "b": (nothing, unmoved),
        "b2": (nothing, warped),
        "c": (images.plane, unmoved),
        "d": (nothing, np.where(ground, unmoved, network)),
        "e": (images.plane, network),
    }
    bits: Bits = {("a", "ppmd"): 8 * _unpredicted_bytes(level[level > 0], ground[level > 0])}
    for variant, (plane, before) in given.items():
        bits[variant, "ppmd"] = 8 * _residual_bytes(
            residuals(level, ground, plane, before), ground[level > 0]
        )
    # The context coder knows the neighbours in any case; here (a) is what they alone give.
    for variant, (plane, before) in {"a": (nothing, nothing), **given}.items():
        bits[variant, "context"] = 8 * _context_bytes(level, ground, images, plane, before)
    return bits


def _residual_bytes(values: NDArray[np.int32], ground: NDArray[np.bool_]) -> int:
    symbols, rest = to_symbols(values[ground_first(ground)])
    return len(CODERS["ppmd"].encode(symbols)) + len(rest)


def _unpredicted_bytes(values: NDArray[np.int32], ground: NDArray[np.bool_]) -> int:
    """Levels as they are, by planes of bytes or as residuals are, whichever is less."""
    planes = b"".join(((values >> shift) & 255).astype(np.uint8).tobytes() for shift in (16, 8, 0))
    return min(len(CODERS["ppmd"].encode(planes)), _residual_bytes(values, ground))


def _context_bytes(
    level: NDArray[np.int32],
    ground: NDArray[np.bool_],
    images: Images,
    plane: NDArray[np.int32],
    before: NDArray[np.int32],
) -> int:
    given = replace(images, plane=plane, frame=before, spread=np.zeros_like(images.spread))
    if before is images.frame:
        given = replace(given, spread=images.spread)
    return len(ContextImages().encode(level, ground, given)[2])


def _warped(frame: Frame, last: Frame) -> NDArray[np.int32]:
    """The last frame moved into this one, by the warp that the network starts from."""
    from salpcc.stages.predict.paper.st_lstm.warp import pose_of, warp

    if frame.predicted.motion is None:
        return last.sweep.level
    accuracy = frame.sweep.accuracy
    millimetres = np.rint(last.sweep.level * accuracy * 1e3).astype(np.int32)
    pose = pose_of(frame.predicted.motion * UNITS)
    moved, _ = warp(millimetres, pose, (frame.sweep.elevation * ELEVATION_UNIT).astype(np.float64))
    return np.rint(moved * 1e-3 / accuracy).astype(np.int32)


def study(root: Path, sequences: Sequence[str], accuracy: float) -> list[dict[str, Any]]:
    """Return ABLATIONS rows of some sequences, and of all of them together."""
    rows = []
    every: Bits = {}
    counted = 0
    for sequence in sequences:
        bits: Bits = {}
        returns = 0
        for scans in read_gops(root, sequence):
            frames = paper_frames(scans, accuracy)
            for last, frame in pairwise(frames):
                returns += len(frame.sweep)
                for key, n in frame_bits(frame, last).items():
                    bits[key] = bits.get(key, 0) + n
                    every[key] = every.get(key, 0) + n
        counted += returns
        rows += _rows(sequence, bits, returns)
    return rows + _rows("all", every, counted)


def _rows(sequence: str, bits: Bits, returns: int) -> list[dict[str, Any]]:
    return [
        {
            "study": STUDY,
            "sequence": sequence,
            "variant": VARIANTS[variant],
            "measure": MEASURES[coder],
            "value": n / returns,
        }
        for (variant, coder), n in bits.items()
        if returns
    ]


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure, write the record ``ablations`` of OUT, print it."""
    parser = argparse.ArgumentParser(description="What prediction brings (paper profile)")
    parser.add_argument("--root", type=Path, required=True)
    parser.add_argument("--sequences", default="04")
    parser.add_argument("--max-error", type=float, default=0.001)
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args(arguments)
    rows = study(options.root, options.sequences.split(","), options.max_error)
    record(options.out, ablations=pa.Table.from_pylist(rows, schema=ABLATIONS))
    for row in rows:
        print(f"{row['sequence']}  {row['variant']:26} {row['measure']:32} {row['value']:.3f}")


if __name__ == "__main__":
    main()
