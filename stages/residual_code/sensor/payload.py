"""The payload of one scan: a header, the coded streams, and two checksums (schemas/ARCHIVE.md).

The last four bytes check the payload as it lies in the file, before anything is decoded. A second CRC
in the header is of the plain content: it catches an encoder and a decoder that disagree.
"""

from __future__ import annotations

import struct
import zlib
from functools import cache
from typing import NamedTuple

import numpy as np

from salpcc.schemas.errors import ArchiveError
from salpcc.stages.residual_code.sensor.header import (
    CODEC_VERSION,
    EFFORTS,
    LAYER,
    MAX_POINTS,
    MOTION,
    SIX,
    SOURCE,
    Header,
)
from salpcc.stages.residual_code.sensor.scan_state import Decoding, Encoding
from salpcc.stages.residual_code.sensor.streams import STREAMS
from salpcc.stages.residual_code.stream import GROUPS, Payload, Stream

_CRC = struct.Struct("<I")
_LENGTH = struct.Struct("<I")  # of a stream that is there only with a flag


class _Layout(NamedTuple):
    """How the rows of a table of streams lie in a payload."""

    rows: list[Stream[Encoding, Decoding]]  # in their places
    always: list[str]  # names of those whose length is in the fixed part
    fixed: struct.Struct


@cache
def _layout(table: tuple[Stream[Encoding, Decoding], ...]) -> _Layout:
    rows = sorted(table, key=lambda row: row.place)
    always = [row.name for row in rows if not row.flag]
    return _Layout(rows, always, struct.Struct(f"<BBBBIIIIddd I 8s {len(always)}I"))


def pack(header: Header, streams: dict[str, bytes]) -> Payload:
    """Join header and streams (one per row of STREAMS; empty where its flag is not set)."""
    rows, always, fixed_part = _layout(STREAMS)
    fixed = fixed_part.pack(
        CODEC_VERSION, header.flags, EFFORTS.index(header.effort), 0,
        header.n_points, header.returns, header.strays, header.step,
        header.max_error, header.millimetre_reach, header.ulp_reach,
        header.content_crc, header.weights, *(len(streams[name]) for name in always),
    )  # fmt: skip
    motion = b"" if header.motion is None else SIX.pack(*header.motion)
    sizes = dict.fromkeys(GROUPS, 0) | {"geometry": len(fixed) + len(motion), "side": _CRC.size}
    lengths = b""
    for row in rows:
        if row.flag & header.flags:
            lengths += _LENGTH.pack(len(streams[row.name]))
            sizes[row.group] += _LENGTH.size
        sizes[row.group] += len(streams[row.name])
    body = b"".join([fixed, motion, lengths, *(streams[row.name] for row in rows)])
    return Payload(body + _CRC.pack(zlib.crc32(body)), sizes)


def unpack(data: bytes) -> tuple[Header, dict[str, bytes]]:
    """Take a payload apart; inverse of :func:`pack`.

    Raises:
        ArchiveError: the checksum fails, the version is newer, or a length does not fit.
    """
    rows, always, fixed = _layout(STREAMS)
    if len(data) < fixed.size + _CRC.size:
        raise ArchiveError("payload is truncated")
    (crc,) = _CRC.unpack_from(data, len(data) - _CRC.size)
    if zlib.crc32(data[: -_CRC.size]) != crc:
        raise ArchiveError("payload is damaged (checksum differs)")
    fields = fixed.unpack_from(data)
    version, flags, effort, reserved, n_points, returns, strays, step, *more = fields
    max_error, millimetre_reach, ulp_reach, content_crc, weights, *given = more
    if version != CODEC_VERSION:
        raise ArchiveError(f"payload has codec version {version}, this tool reads {CODEC_VERSION}")
    position = fixed.size
    motion = None
    if flags & MOTION:
        if len(data) < position + SIX.size + _CRC.size:
            raise ArchiveError("payload is truncated")
        motion = np.array(SIX.unpack_from(data, position))
        position += SIX.size
    lengths = dict(zip(always, given, strict=True))
    for row in rows:
        if flags & row.flag:
            if len(data) < position + _LENGTH.size + _CRC.size:
                raise ArchiveError("payload is truncated")
            (lengths[row.name],) = _LENGTH.unpack_from(data, position)
            position += _LENGTH.size
    sound = (
        effort < len(EFFORTS)
        and flags < 64
        and not flags & MOTION * bool(flags & LAYER)
        and not (flags & SOURCE and returns)
        and reserved == 0
        and returns + strays <= n_points <= MAX_POINTS
        and 1 <= step < 1 << 16
        and all(np.isfinite((max_error, millimetre_reach, ulp_reach)))
        and (max_error > 0 or (max_error == 0 and step == 1))
        and (motion is None or bool(np.isfinite(motion).all()))
        and position + sum(lengths.values()) + _CRC.size == len(data)
    )
    if not sound:
        raise ArchiveError("payload has a header that cannot be")
    header = Header(
        flags=flags,
        effort=EFFORTS[effort],
        n_points=n_points,
        returns=returns,
        strays=strays,
        step=step,
        max_error=max_error,
        millimetre_reach=millimetre_reach,
        ulp_reach=ulp_reach,
        content_crc=content_crc,
        weights=weights,
        motion=motion,
    )
    streams = {}
    for row in rows:
        length = lengths.get(row.name, 0)
        streams[row.name] = data[position : position + length]
        position += length
    return header, streams
