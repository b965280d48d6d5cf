"""The payload of one scan of the ``paper`` profile (schemas/ARCHIVE.md, section 10)."""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from salpcc.schemas.errors import ArchiveError
from salpcc.schemas.grid import COLUMNS, ROWS, GridSweep
from salpcc.stages.residual_code.sensor.payload import GROUPS, MAX_POINTS, Payload

GRID_CODEC = 129  # 128 + version; below 128 are the codec versions of the sensor profile
# The order is part of the format.
CODERS = ("context", "ppmd", "zstd", "lz4", "bzip2", "brotli", "lzma2", "deflate64", "lizard", "lz5")
STREAMS = ("side", "mask", "ground", "levels", "intensity", "classes")
_GROUP_OF_STREAM = (0, 0, 0, 0, 1, 2)

MOTION, CLASSES, FLOAT_INTENSITY, ELEVATION = 1, 2, 4, 8
_FIXED = struct.Struct("<BBBBIId I 6h 8s 6I")
_CRC = struct.Struct("<I")


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


def pack(header: GridHeader, streams: list[bytes]) -> Payload:
    """Join header and streams (one per name in STREAMS)."""
    motion = np.zeros(6, np.int32) if header.motion is None else header.motion
    fixed = _FIXED.pack(
        GRID_CODEC, header.flags, CODERS.index(header.coder), 0, header.n_points, header.returns,
        header.accuracy, header.content_crc, *(int(m) for m in motion), header.weights,
        *(len(stream) for stream in streams),
    )  # fmt: skip
    sizes = dict.fromkeys(GROUPS, 0) | {"geometry": len(fixed), "side": _CRC.size}
    for stream, group in zip(streams, _GROUP_OF_STREAM, strict=True):
        sizes[GROUPS[group]] += len(stream)
    body = b"".join([fixed, *streams])
    return Payload(body + _CRC.pack(zlib.crc32(body)), sizes)


def unpack(data: bytes) -> tuple[GridHeader, list[bytes]]:
    """Take a payload apart; inverse of :func:`pack`.

    Raises:
        ArchiveError: the checksum fails, the version is another, or a field cannot be.
    """
    if len(data) < _FIXED.size + _CRC.size:
        raise ArchiveError("payload is truncated")
    (crc,) = _CRC.unpack_from(data, len(data) - _CRC.size)
    if zlib.crc32(data[: -_CRC.size]) != crc:
        raise ArchiveError("payload is damaged (checksum differs)")
    fields = _FIXED.unpack_from(data)
    version, flags, coder, reserved, n_points, returns, accuracy = fields[:7]
    if version != GRID_CODEC:
        raise ArchiveError(f"payload has codec version {version}, expected {GRID_CODEC}")
    lengths = fields[15:]
    sound = (
        coder < len(CODERS)
        and flags < 16
        and reserved == 0
        and returns <= n_points <= MAX_POINTS
        and returns <= ROWS * COLUMNS
        and 1e-6 <= accuracy <= 10.0
        and _FIXED.size + sum(lengths) + _CRC.size == len(data)
    )
    if not sound:
        raise ArchiveError("payload has a header that cannot be")
    motion = np.array(fields[8:14], np.int32) if flags & MOTION else None
    header = GridHeader(
        flags, CODERS[coder], n_points, returns, accuracy, fields[7], motion, fields[14]
    )  # fmt: skip
    streams, position = [], _FIXED.size
    for length in lengths:
        streams.append(data[position : position + length])
        position += length
    return header, streams
