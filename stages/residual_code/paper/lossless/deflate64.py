"""Deflate64 (inflate64's one level)."""

from __future__ import annotations

import zlib
from contextlib import suppress

from salpcc.schemas.errors import ArchiveError
from salpcc.stages.residual_code.paper.lossless.lossless_coder import Lossless, checked, decoding

_TITLE, _FEED = "Deflate64", 1024


def encode(plain: bytes) -> bytes:
    """Compress; see the contract.

    The library writes a wrong stream now and then (once in our measurements) and says nothing: what does not come
    back is written as stored blocks, which Deflate and Deflate64 share.
    """
    import inflate64

    coder = inflate64.Deflater()
    data = bytes(coder.deflate(plain)) + bytes(coder.flush())
    with suppress(ArchiveError):
        if decode(data, len(plain)) == plain:
            return data
    stored = zlib.compressobj(0, zlib.DEFLATED, -15)
    return stored.compress(plain) + stored.flush()


def decode(data: bytes, size: int) -> bytes:
    """Expand, a little at a time: the library has no bound of its own. Inverse of :func:`encode`."""
    import inflate64

    decoder = inflate64.Inflater()
    parts, length = [], 0
    with decoding(_TITLE, ValueError, RuntimeError, EOFError, MemoryError):
        for start in range(0, len(data), _FEED):
            parts.append(bytes(decoder.inflate(data[start : start + _FEED])))
            length += len(parts[-1])
            if length > size or decoder.eof:
                break
    return checked(_TITLE, b"".join(parts), size)


DEFLATE64 = Lossless(_TITLE, "default", encode, decode)
