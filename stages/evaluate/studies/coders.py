"""Fig. 8: every lossless coder on the residuals of the paper profile, and directly on the scans.

    python -m salpcc.stages.evaluate.studies.coders --root DIR --sequences 04,06 --out OUT

Residuals: mask, ground map and level residuals of every frame, movables dropped by the labels; raw: x, y, z and intensity
of all points as float32. What is coded is decoded again and compared.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from salpcc.schemas.errors import ArchiveError
from salpcc.schemas.scan import Scan
from salpcc.stages.evaluate.measures.metrics import compression_rate
from salpcc.stages.evaluate.report.record import record
from salpcc.stages.evaluate.report.schema import CODERS as CODERS_SCHEMA
from salpcc.stages.evaluate.studies.grid_frames import Frame, paper_frames, read_gops
from salpcc.stages.residual_code.paper.grid_images import IMAGE_CODERS
from salpcc.stages.residual_code.paper.lossless import CODERS, Lossless

_CONTEXT = ("Context", "paper grid, contexts of our own")
Trial = tuple[int, bool, float, float]  # of one piece: bytes coded, whether it came back, CPU seconds of both


def coder_rows(root: Path, sequence: str, accuracy: float, scans: int) -> Iterator[dict[str, Any]]:
    """Yield CODERS rows of the first consecutive ``scans`` of a sequence; a coder that does not give back says so."""
    group = next(read_gops(root, sequence, scans))
    frames = paper_frames(group, accuracy)
    common = {"sequence": sequence, "points": sum(len(scan) for _, scan in group)}
    for name in IMAGE_CODERS:
        coder = CODERS.get(name)
        title, settings = (coder.title, coder.settings) if coder else _CONTEXT
        row = common | {"coder": title, "settings": settings, "input": "residual", "max_error": accuracy}
        _sum(_on_residuals(name, frames[:1]))  # numba compiles
        yield row | _sum(_on_residuals(name, frames))
    for coder in CODERS.values():
        row = common | {"coder": coder.title, "settings": coder.settings, "input": "raw"}
        yield row | _sum(_on_scans(coder, [scan for _, scan in group]))


def _on_residuals(name: str, frames: Sequence[Frame]) -> Iterator[Trial]:
    """The frames of a GOP, one after the other."""
    writer, reader = IMAGE_CODERS[name](), IMAGE_CODERS[name]()
    for frame in frames:
        images = frame.images
        start = time.process_time()
        streams = writer.encode(frame.sweep.level, frame.ground, images)
        middle = time.process_time()
        back = reader.decode(*streams, len(frame.sweep), images)
        end = time.process_time()
        yield sum(map(len, streams)), np.array_equal(back, frame.sweep.level), middle - start, end - middle


def _on_scans(coder: Lossless, scans: Sequence[Scan]) -> Iterator[Trial]:
    for scan in scans:
        plain = np.column_stack([scan.points, scan.intensity]).astype("<f4").tobytes()
        start = time.process_time()
        coded = coder.encode(plain)
        middle = time.process_time()
        back = coder.decode(coded, len(plain))
        yield len(coded), back == plain, middle - start, time.process_time() - middle


def _sum(trials: Iterable[Trial]) -> dict[str, Any]:
    """Add the trials of a coder up to the columns of its row."""
    size, encode, decode = 0, 0.0, 0.0
    try:
        for coded, same, there, back in trials:
            if not same:
                return {"status": "failed: gives back something else"}
            size, encode, decode = size + coded, encode + there, decode + back
    except ArchiveError as error:
        return {"status": f"failed: {error}"}
    return {"bytes_out": size, "encode_ms": 1e3 * encode, "decode_ms": 1e3 * decode, "status": "ok"}


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure, and write the record ``coders`` of OUT, which the report of OUT shows."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--root", type=Path, required=True)
    parser.add_argument("--sequences", default="04")
    parser.add_argument("--max-error", type=float, default=0.001)
    parser.add_argument("--scans", type=int, default=6, help="consecutive scans of each sequence")
    parser.add_argument("--out", type=Path, required=True)
    asked = parser.parse_args(arguments)
    rows: list[dict[str, Any]] = []
    for sequence in asked.sequences.split(","):
        for row in coder_rows(asked.root, sequence, asked.max_error, asked.scans):
            ran = row["status"] == "ok"
            rate = f"{compression_rate(row['bytes_out'], row['points']):.3f} %" if ran else row["status"]
            print(f"{sequence}  {row['input']:9} {row['coder']:12} {rate}", flush=True)
            rows.append(row)
    record(asked.out, coders=pa.Table.from_pylist(rows, schema=CODERS_SCHEMA))


if __name__ == "__main__":
    main()
