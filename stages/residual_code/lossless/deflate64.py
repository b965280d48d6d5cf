"""Deflate64 (inflate64's one level)."""

from __future__ import annotations

import inflate64

from salpcc.schemas.errors import ArchiveError
from salpcc.stages.residual_code.lossless.contract import Lossless, checked

_TITLE, _FEED = "Deflate64", 1024


def encode(plain: bytes) -> bytes:
    """Compress; see the contract."""
    coder = inflate64.Deflater()
    return bytes(coder.deflate(plain)) + bytes(coder.flush())


def decode(data: bytes, size: int) -> bytes:
    """Expand, a little at a time: the library has no bound of its own. Inverse of :func:`encode`."""
    decoder = inflate64.Inflater()
    parts, length = [], 0
    try:
        for start in range(0, len(data), _FEED):
            parts.append(bytes(decoder.inflate(data[start : start + _FEED])))
            length += len(parts[-1])
            if length > size or decoder.eof:
                break
    except (ValueError, RuntimeError, EOFError, MemoryError) as error:
        raise ArchiveError(f"{_TITLE} stream is damaged") from error
    return checked(_TITLE, b"".join(parts), size)


DEFLATE64 = Lossless(_TITLE, "default", encode, decode)
