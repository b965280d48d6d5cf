"""LZMA2, preset 5, 16 MiB dictionary (raw stream)."""

from __future__ import annotations

import lzma

from salpcc.stages.residual_code.paper.lossless.lossless_coder import Lossless, checked, decoding

_TITLE = "LZMA2"
_FILTERS = [{"id": lzma.FILTER_LZMA2, "preset": 5, "dict_size": 16 << 20}]


def encode(plain: bytes) -> bytes:
    """Compress; see the contract."""
    return lzma.compress(plain, lzma.FORMAT_RAW, filters=_FILTERS)


def decode(data: bytes, size: int) -> bytes:
    """Expand; inverse of :func:`encode`."""
    with decoding(_TITLE, lzma.LZMAError, EOFError):
        plain = lzma.LZMADecompressor(lzma.FORMAT_RAW, filters=_FILTERS).decompress(data, max_length=size + 1)
    return checked(_TITLE, plain, size)


LZMA2 = Lossless(_TITLE, "preset 5, 16 MiB", encode, decode)
