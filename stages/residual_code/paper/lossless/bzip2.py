"""BZip2, blocks of 900 kB."""

from __future__ import annotations

import bz2

from salpcc.stages.residual_code.paper.lossless.lossless_coder import Lossless, checked, decoding

_TITLE = "BZip2"


def encode(plain: bytes) -> bytes:
    """Compress; see the contract."""
    return bz2.compress(plain, 9)


def decode(data: bytes, size: int) -> bytes:
    """Expand; inverse of :func:`encode`."""
    decoder = bz2.BZ2Decompressor()
    with decoding(_TITLE, OSError, EOFError):
        plain = decoder.decompress(data, max_length=size + 1)
    return checked(_TITLE, plain, size)


BZIP2 = Lossless(_TITLE, "900 kB blocks", encode, decode)
