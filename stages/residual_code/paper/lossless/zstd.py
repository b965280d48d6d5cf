"""Zstandard, level 3."""

from __future__ import annotations

import zstandard

from salpcc.stages.residual_code.paper.lossless.lossless_coder import Lossless, checked, decoding

_TITLE, _LEVEL = "Zstandard", 3


def encode(plain: bytes) -> bytes:
    """Compress; see the contract."""
    return zstandard.ZstdCompressor(level=_LEVEL).compress(plain)


def decode(data: bytes, size: int) -> bytes:
    """Expand; inverse of :func:`encode`."""
    with decoding(_TITLE, zstandard.ZstdError):
        # Not decompress(): it would allocate what the frame claims.
        plain = zstandard.ZstdDecompressor().stream_reader(data).read(size + 1)
    return checked(_TITLE, plain, size)


ZSTD = Lossless(_TITLE, f"level {_LEVEL}", encode, decode)
