"""The payload of one scan: a header, the coded streams, and two checksums (schemas/ARCHIVE.md).

The last four bytes check the payload as it lies in the file, before anything is decoded. A second CRC
in the header is of the plain content: it catches an encoder and a decoder that disagree.
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from salpcc.schemas.errors import ArchiveError
from salpcc.schemas.sweep import Sweep

CODEC_VERSION = 3
EFFORTS = ("fast", "default", "max")
STREAMS = (
    "mask",
    "levels",
    "millimetre",
    "ulp",
    "stray_points",
    "intensity",
    "stray_intensity",
    "classes",
    "cloud",  # only with its flag
    "lead",  # only of a movable layer
)
GROUPS = ("geometry", "intensity", "classes", "side")
_GROUP_OF_STREAM = (0, 0, 0, 0, 0, 1, 1, 2, 3, 0)

MOTION, CLASSES, FLOAT_INTENSITY, CLOUD, LAYER = 1, 2, 4, 8, 16
_MORE = ((8, CLOUD), (9, LAYER))  # streams that only flags bring, with lengths of their own
_FIXED = struct.Struct("<BBBBIIIIddd I 8s 8I")
_MOTION = struct.Struct("<6d")
_CRC = struct.Struct("<I")
_LENGTH = struct.Struct("<I")  # of such a stream
_CLOUD = struct.Struct("<qIB")
_FACTS = struct.Struct("<QQd")
MAX_POINTS = 1 << 24


@dataclass(frozen=True)
class Payload:
    """Bytes of one scan and how many of them each group of streams took; the groups add up to all."""

    data: bytes
    sizes: dict[str, int]


@dataclass(frozen=True)
class Header:
    """What a decoder must know before the streams; counts are of kept points.

    ``weights`` is the first 8 bytes of the digest of the learned models or of the tables.
    """

    flags: int
    effort: str
    n_points: int
    returns: int
    strays: int
    step: int
    max_error: float
    millimetre_reach: float
    ulp_reach: float
    content_crc: int
    weights: bytes
    motion: NDArray[np.float64] | None


def content_crc(sweep: Sweep) -> int:
    """CRC-32 of all that a sweep decodes to."""
    crc = zlib.crc32(_FACTS.pack(sweep.n_points, sweep.step, sweep.max_error))
    if sweep.motion is not None:
        crc = zlib.crc32(_MOTION.pack(*sweep.motion), crc)
    for array, kind in (
        (sweep.laser, "u1"),
        (sweep.tick, "<i4"),
        (sweep.count, "<i4"),
        (sweep.intensity, "<f4"),
        (sweep.millimetre, "u1"),
        (sweep.ulp, "u1"),
        (sweep.stray_index, "<i8"),
        (sweep.stray_points, "<f4"),
        (sweep.classes, "u1"),
        (sweep.stray_classes, "u1"),
        (sweep.lead, "<i8"),
    ):
        if array is not None:
            crc = zlib.crc32(np.ascontiguousarray(array, dtype=kind).tobytes(), crc)
    if sweep.cloud is not None:
        cloud = sweep.cloud
        crc = zlib.crc32(_CLOUD.pack(cloud.delay, cloud.sequence, cloud.whole), crc)
        parts = [cloud.topic.encode(), cloud.encoding.encode(), cloud.head, cloud.tail, cloud.loose]
        for part in [*parts, *([cloud.channel.to_bytes(2, "little")] if cloud.channel else ())]:
            crc = zlib.crc32(part, crc)
        crc = zlib.crc32(np.ascontiguousarray(cloud.rest).tobytes(), crc)
    return crc


def pack(header: Header, streams: list[bytes]) -> Payload:
    """Join header and streams (one per name in STREAMS; empty where its flag is not set)."""
    parts = [
        _FIXED.pack(
            CODEC_VERSION, header.flags, EFFORTS.index(header.effort), 0,
            header.n_points, header.returns, header.strays, header.step,
            header.max_error, header.millimetre_reach, header.ulp_reach,
            header.content_crc, header.weights, *(len(stream) for stream in streams[:8]),
        )
    ]  # fmt: skip
    if header.motion is not None:
        parts.append(_MOTION.pack(*header.motion))
    parts += [_LENGTH.pack(len(streams[place])) for place, flag in _MORE if header.flags & flag]
    body = b"".join(parts + streams)
    return Payload(body + _CRC.pack(zlib.crc32(body)), _sizes(header, streams))


def _sizes(header: Header, streams: list[bytes]) -> dict[str, int]:
    """Bytes of a payload by group."""
    found = dict.fromkeys(GROUPS, 0)
    found["geometry"] = _FIXED.size + (header.motion is not None) * _MOTION.size
    found["side"] = _CRC.size
    for place, flag in _MORE:
        found[GROUPS[_GROUP_OF_STREAM[place]]] += bool(header.flags & flag) * _LENGTH.size
    for stream, group in zip(streams, _GROUP_OF_STREAM, strict=True):
        found[GROUPS[group]] += len(stream)
    return found


def unpack(data: bytes) -> tuple[Header, list[bytes]]:
    """Take a payload apart; inverse of :func:`pack`.

    Raises:
        ArchiveError: the checksum fails, the version is newer, or a length does not fit.
    """
    if len(data) < _FIXED.size + _CRC.size:
        raise ArchiveError("payload is truncated")
    (crc,) = _CRC.unpack_from(data, len(data) - _CRC.size)
    if zlib.crc32(data[: -_CRC.size]) != crc:
        raise ArchiveError("payload is damaged (checksum differs)")
    fields = _FIXED.unpack_from(data)
    version, flags, effort, reserved, n_points, returns, strays, step = fields[:8]
    if version != CODEC_VERSION:
        raise ArchiveError(f"payload has codec version {version}, this tool reads {CODEC_VERSION}")
    position = _FIXED.size
    motion = None
    if flags & MOTION:
        if len(data) < position + _MOTION.size + _CRC.size:
            raise ArchiveError("payload is truncated")
        motion = np.array(_MOTION.unpack_from(data, position))
        position += _MOTION.size
    lengths = [*fields[13:], 0, 0]
    for place, flag in _MORE:
        if flags & flag:
            if len(data) < position + _LENGTH.size + _CRC.size:
                raise ArchiveError("payload is truncated")
            (lengths[place],) = _LENGTH.unpack_from(data, position)
            position += _LENGTH.size
    sound = (
        effort < len(EFFORTS)
        and flags < 32
        and not flags & MOTION * bool(flags & LAYER)
        and reserved == 0
        and returns + strays <= n_points <= MAX_POINTS
        and 1 <= step < 1 << 16
        and all(np.isfinite(fields[8:11]))
        and (fields[8] > 0 or (fields[8] == 0 and step == 1))
        and (motion is None or bool(np.isfinite(motion).all()))
        and position + sum(lengths) + _CRC.size == len(data)
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
        max_error=fields[8],
        millimetre_reach=fields[9],
        ulp_reach=fields[10],
        content_crc=fields[11],
        weights=fields[12],
        motion=motion,
    )
    streams = []
    for length in lengths:
        streams.append(data[position : position + length])
        position += length
    return header, streams
