"""PPMd variant H, order 6, 16 MiB.

pyppmd 1.3.1 corrupts streams when ``encode`` gets a large buffer, so it is fed 4,096 bytes a call, what it wrote
is decoded again before it is trusted, and the plain size and a checksum stand before the stream: neither
unverified bytes nor a wrong size must reach its decoder, which would write outside its memory.
"""

from __future__ import annotations

import struct
import zlib

from salpcc.schemas.errors import ArchiveError
from salpcc.stages.residual_code.paper.lossless.lossless_coder import Lossless, checked, decoding

_TITLE = "PPMd"
_ORDER, _MEMORY, _FEED = 6, 16 << 20, 4096
_HEAD = struct.Struct("<II")  # plain size; CRC-32 of that and the stream


def encode(plain: bytes) -> bytes:
    """Compress; see the contract.

    Raises:
        ArchiveError: the library's stream does not decode to what went in.
    """
    import pyppmd

    if not plain:
        return b""
    coder = pyppmd.Ppmd7Encoder(_ORDER, _MEMORY)
    parts = [coder.encode(plain[start : start + _FEED]) for start in range(0, len(plain), _FEED)]
    stream = b"".join([*parts, coder.flush()])
    if _expand(stream, len(plain)) != plain:
        raise ArchiveError(f"{_TITLE} (pyppmd {pyppmd.__version__}) wrote a stream that does not decode")
    return _HEAD.pack(len(plain), _crc(len(plain), stream)) + stream


def decode(data: bytes, size: int) -> bytes:
    """Expand; inverse of :func:`encode`."""
    if size == 0:
        return checked(_TITLE, data, 0)
    stream = data[_HEAD.size :]
    if not stream or _HEAD.unpack_from(data) != (size, _crc(size, stream)):
        raise ArchiveError(f"{_TITLE} stream is damaged")
    return checked(_TITLE, _expand(stream, size), size)


def _crc(size: int, stream: bytes) -> int:
    return zlib.crc32(stream, size)


def _expand(stream: bytes, size: int) -> bytes:
    import pyppmd

    with decoding(_TITLE, ValueError, EOFError, RuntimeError):
        return bytes(pyppmd.Ppmd7Decoder(_ORDER, _MEMORY).decode(stream, size))


PPMD = Lossless(_TITLE, "variant H, order 6, 16 MiB", encode, decode)
