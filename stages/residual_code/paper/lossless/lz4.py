"""LZ4, level 3 (frames)."""

from __future__ import annotations

import lz4.frame

from salpcc.stages.residual_code.paper.lossless.lossless_coder import Lossless, checked, decoding

_TITLE, _LEVEL = "LZ4", 3


def encode(plain: bytes) -> bytes:
    """Compress; see the contract."""
    return bytes(lz4.frame.compress(plain, compression_level=_LEVEL))


def decode(data: bytes, size: int) -> bytes:
    """Expand; inverse of :func:`encode`."""
    with decoding(_TITLE, RuntimeError, EOFError):
        plain = bytes(lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=size + 1))
    return checked(_TITLE, plain, size)


LZ4 = Lossless(_TITLE, f"level {_LEVEL}", encode, decode)
