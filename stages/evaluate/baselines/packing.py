"""The byte coder that the re-implemented baselines share: raw LZMA2."""

from __future__ import annotations

import lzma
import struct
from itertools import pairwise

import numpy as np

_FILTERS = [{"id": lzma.FILTER_LZMA2, "preset": 6}]


def pack(data: bytes) -> bytes:
    """Compress."""
    return lzma.compress(data, lzma.FORMAT_RAW, filters=_FILTERS)


def unpack(data: bytes) -> bytes:
    """Inverse of :func:`pack`."""
    return lzma.decompress(data, lzma.FORMAT_RAW, filters=_FILTERS)


def pack_streams(head: bytes, *streams: bytes) -> bytes:
    """Put a head as it is, then the sizes of the packed streams, then the streams."""
    packed = [pack(stream) for stream in streams]
    return head + struct.pack(f"<{len(packed)}I", *map(len, packed)) + b"".join(packed)


def unpack_streams(data: bytes, head_size: int, count: int) -> list[bytes]:
    """Return the streams of :func:`pack_streams`."""
    sizes = struct.unpack_from(f"<{count}I", data, head_size)
    ends = np.cumsum([head_size + 4 * count, *sizes]).tolist()
    return [unpack(data[start:end]) for start, end in pairwise(ends)]
