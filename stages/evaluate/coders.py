"""Fig. 8: every lossless coder on the residuals of the paper profile, and directly on the scans.

    python -m salpcc.stages.evaluate.coders --root DIR --sequences 04,06 --out OUT

Residuals: mask, ground map and level residuals of every frame, movables dropped by the labels; raw: x, y, z and intensity
of all points as float32. What is coded is decoded again and compared.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from salpcc.schemas.errors import ArchiveError
from salpcc.schemas.scan import Scan
from salpcc.stages.evaluate.grid_frames import Frame, paper_frames, read_gops
from salpcc.stages.evaluate.metrics import compression_rate
from salpcc.stages.evaluate.record import record
from salpcc.stages.evaluate.schema import CODERS as CODERS_SCHEMA
from salpcc.stages.residual_code.grid_context import ContextImages
from salpcc.stages.residual_code.grid_images import plain_streams
from salpcc.stages.residual_code.lossless import CODERS, Lossless

_WARM_UP = bytes(range(256)) * 4


@dataclass
class Sum:
    """What a coder took and gave so far, and its CPU time."""

    bytes_in: int = 0
    bytes_out: int = 0
    encode_ms: float = 0.0
    decode_ms: float = 0.0

    def add(self, coder: Lossless, plain: bytes) -> None:
        """Code and decode a piece.

        Raises:
            ArchiveError: it does not come back.
        """
        start = time.process_time()
        coded = coder.encode(plain)
        middle = time.process_time()
        back = coder.decode(coded, len(plain))
        end = time.process_time()
        if back != plain:
            raise ArchiveError(f"{coder.title}: {len(plain)} bytes do not come back")
        self.bytes_in += len(plain)
        self.bytes_out += len(coded)
        self.encode_ms += 1e3 * (middle - start)
        self.decode_ms += 1e3 * (end - middle)


def coder_rows(root: Path, sequence: str, accuracy: float, scans: int) -> Iterator[dict[str, Any]]:
    """Yield CODERS rows of the first consecutive ``scans`` of a sequence; one that does not give back says so."""
    group = next(read_gops(root, sequence, scans))
    frames = paper_frames(group, accuracy)
    points = sum(len(scan) for _, scan in group)
    residual = [plain for f in frames for plain in plain_streams(f.sweep.level, f.ground, f.images)]
    raw = [_raw(scan) for _, scan in group]
    for kind, pieces, error in (("residual", residual, accuracy), ("raw", raw, None)):
        for coder in CODERS.values():
            coder.decode(coder.encode(_WARM_UP), len(_WARM_UP))
            total, status = Sum(), "ok"
            try:
                for plain in pieces:
                    total.add(coder, plain)
            except ArchiveError as reason:
                status = f"failed: {reason}"
            yield _row(sequence, coder.title, coder.settings, kind, error, points, total, status)
    yield _row(
        sequence,
        "Context",
        "paper grid, our contexts",
        "residual",
        accuracy,
        points,
        _context(frames, sum(map(len, residual))),
    )


def _context(frames: Sequence[Frame], bytes_in: int) -> Sum:
    """Code the frames of a GOP with our context coder; warmed up, and decoded to what they were."""
    ContextImages().encode(frames[0].sweep.level, frames[0].ground, frames[0].images)
    total, writer, reader = Sum(bytes_in), ContextImages(), ContextImages()
    for frame in frames:
        images = frame.images
        start = time.process_time()
        streams = writer.encode(frame.sweep.level, frame.ground, images)
        middle = time.process_time()
        back = reader.decode(*streams, len(frame.sweep), images)
        end = time.process_time()
        if not np.array_equal(back, frame.sweep.level):
            raise ArchiveError(f"context coder: scan {frame.sweep.name} does not come back")
        total.bytes_out += sum(map(len, streams))
        total.encode_ms += 1e3 * (middle - start)
        total.decode_ms += 1e3 * (end - middle)
    return total


def _raw(scan: Scan) -> bytes:
    return np.column_stack([scan.points, scan.intensity]).astype("<f4").tobytes()


def _row(
    sequence: str,
    coder: str,
    settings: str,
    kind: str,
    error: float | None,
    points: int,
    total: Sum,
    status: str = "ok",
) -> dict[str, Any]:
    row = {"sequence": sequence, "coder": coder, "settings": settings, "input": kind, "max_error": error}
    return row | {"points": points, "status": status, **vars(total)}


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
            rate = (
                f"{compression_rate(row['bytes_out'], row['points']):.3f} %"
                if row["status"] == "ok"
                else row["status"]
            )
            print(f"{sequence}  {row['input']:9} {row['coder']:12} {rate}", flush=True)
            rows.append(row)
    record(asked.out, coders=pa.Table.from_pylist(rows, schema=CODERS_SCHEMA))


if __name__ == "__main__":
    main()
