"""The payload of one scan of the ``paper`` profile (schemas/ARCHIVE.md, section 10)."""

from __future__ import annotations

import struct
import zlib

import numpy as np

from salpcc.schemas.errors import ArchiveError
from salpcc.schemas.grid import COLUMNS, ROWS
from salpcc.stages.residual_code.paper.grid_header import CODERS, GRID_CODEC, MOTION, GridHeader
from salpcc.stages.residual_code.paper.grid_streams import STREAMS
from salpcc.stages.residual_code.sensor.header import MAX_POINTS
from salpcc.stages.residual_code.stream import GROUPS, Payload

_FIXED = struct.Struct(f"<BBBBIId I 6h 8s {len(STREAMS)}I")
_CRC = struct.Struct("<I")


def pack(header: GridHeader, streams: dict[str, bytes]) -> Payload:
    """Join header and streams (one per row of STREAMS)."""
    motion = np.zeros(6, np.int32) if header.motion is None else header.motion
    fixed = _FIXED.pack(
        GRID_CODEC, header.flags, CODERS.index(header.coder), 0, header.n_points, header.returns,
        header.accuracy, header.content_crc, *(int(m) for m in motion), header.weights,
        *(len(streams[row.name]) for row in STREAMS),
    )  # fmt: skip
    sizes = dict.fromkeys(GROUPS, 0) | {"geometry": len(fixed), "side": _CRC.size}
    for row in STREAMS:
        sizes[row.group] += len(streams[row.name])
    body = b"".join([fixed, *(streams[row.name] for row in STREAMS)])
    return Payload(body + _CRC.pack(zlib.crc32(body)), sizes)


def unpack(data: bytes) -> tuple[GridHeader, dict[str, bytes]]:
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
    streams, position = {}, _FIXED.size
    for row, length in zip(STREAMS, lengths, strict=True):
        streams[row.name] = data[position : position + length]
        position += length
    return header, streams
