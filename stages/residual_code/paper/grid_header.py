"""What stands in front of the streams of a grid, and the checksum of what they decode to (schemas/ARCHIVE.md, section 10)."""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass
from typing import get_args

import numpy as np
from numpy.typing import NDArray

from salpcc.schemas.config import Coder
from salpcc.schemas.grid import GridSweep

GRID_CODEC = 129  # 128 + version; below 128 are the codec versions of the sensor profile
CODERS: tuple[str, ...] = get_args(Coder)  # payloads hold the number
MOTION, CLASSES, FLOAT_INTENSITY, ELEVATION = 1, 2, 4, 8


@dataclass(frozen=True)
class GridHeader:
    """What a decoder must know before the streams.

    ``motion`` from the frame before, in whole units, is None where the frame is predicted from none;
    ``weights`` names the prediction network, zeros without a motion.
    """

    flags: int
    coder: str
    n_points: int
    returns: int
    accuracy: float
    content_crc: int
    motion: NDArray[np.int32] | None
    weights: bytes


def content_crc(sweep: GridSweep) -> int:
    """CRC-32 of all that a grid sweep decodes to."""
    crc = zlib.crc32(struct.pack("<Qd", sweep.n_points, sweep.accuracy))
    for array, kind in (
        (sweep.elevation, "<i2"),
        (sweep.level, "<i4"),
        (sweep.intensity, "<f4"),
        (sweep.classes, "u1"),
    ):
        if array is not None:
            crc = zlib.crc32(np.ascontiguousarray(array, dtype=kind).tobytes(), crc)
    return crc
