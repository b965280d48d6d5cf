"""What stands in front of the streams of a scan, and the checksum of what they decode to (schemas/ARCHIVE.md)."""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from salpcc.schemas.sweep import Sweep

CODEC_VERSION = 3
EFFORTS = ("fast", "default", "max")
MOTION, CLASSES, FLOAT_INTENSITY, CLOUD, LAYER, SOURCE = 1, 2, 4, 8, 16, 32
MAX_POINTS = 1 << 24
SIX = struct.Struct("<6d")  # a motion
_CLOUD = struct.Struct("<qIB")
_FACTS = struct.Struct("<QQd")


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
        crc = zlib.crc32(SIX.pack(*sweep.motion), crc)
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
        (sweep.source, "<i8"),
        (sweep.lead, "<i8"),
    ):
        if array is not None:
            crc = zlib.crc32(np.ascontiguousarray(array, dtype=kind).data, crc)
    if sweep.cloud is not None:
        cloud = sweep.cloud
        crc = zlib.crc32(_CLOUD.pack(cloud.delay, cloud.sequence, cloud.whole), crc)
        parts = [cloud.topic.encode(), cloud.encoding.encode(), cloud.head, cloud.tail, cloud.loose]
        for part in [*parts, *([cloud.channel.to_bytes(2, "little")] if cloud.channel else ())]:
            crc = zlib.crc32(part, crc)
        crc = zlib.crc32(np.ascontiguousarray(cloud.rest).data, crc)
    return crc
