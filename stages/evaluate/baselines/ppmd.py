"""PPMd (variant H, as 7-Zip: order 6, 16 MiB) on the raw float32 file.

pyppmd 1.3.1 corrupts streams when ``encode`` gets a large buffer, so it is fed 4,096 bytes a call; checksums of
the stream and of the plain bytes stand in front, and the stream's is checked before anything is decoded.
"""

from __future__ import annotations

import struct
import zlib

from salpcc.stages.evaluate.baselines.baseline import Baseline, NotPossible, Points
from salpcc.stages.evaluate.baselines.generic import EXACT, from_file, to_file

_ORDER, _MEMORY, _FEED = 6, 16 << 20, 4096
_HEAD = struct.Struct("<III")  # plain size, CRC of the plain bytes, CRC of the stream


def encode(points: Points, max_error: float) -> bytes:
    """Compress the file; see :mod:`salpcc.stages.evaluate.baselines.baseline`."""
    import pyppmd

    plain = to_file(points, max_error)
    coder = pyppmd.Ppmd7Encoder(_ORDER, _MEMORY)
    parts = [coder.encode(plain[start : start + _FEED]) for start in range(0, len(plain), _FEED)]
    stream = b"".join([*parts, coder.flush()])
    return _HEAD.pack(len(plain), zlib.crc32(plain), zlib.crc32(stream)) + stream


def decode(data: bytes) -> Points:
    """Expand the file.

    Raises:
        NotPossible: a checksum does not match.
    """
    import pyppmd

    size, plain_crc, stream_crc = _HEAD.unpack_from(data)
    stream = data[_HEAD.size :]
    if zlib.crc32(stream) != stream_crc:
        raise NotPossible("the PPMd stream is damaged")
    plain = bytes(pyppmd.Ppmd7Decoder(_ORDER, _MEMORY).decode(stream, size))
    if zlib.crc32(plain) != plain_crc:
        raise NotPossible("the PPMd stream does not decode to what was encoded")
    return from_file(plain)


PPMD = Baseline("PPMd7, order 6", (), EXACT, encode, decode)
