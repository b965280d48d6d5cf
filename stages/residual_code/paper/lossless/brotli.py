"""Brotli, quality 3."""

from __future__ import annotations

from salpcc.stages.residual_code.paper.lossless.lossless_coder import Lossless, checked, decoding

_TITLE, _QUALITY = "Brotli", 3


def encode(plain: bytes) -> bytes:
    """Compress; see the contract."""
    import brotli

    return bytes(brotli.compress(plain, quality=_QUALITY))


def decode(data: bytes, size: int) -> bytes:
    """Expand; inverse of :func:`encode`."""
    import brotli

    decoder = brotli.Decompressor()
    with decoding(_TITLE, brotli.error):
        plain = bytes(decoder.process(data, output_buffer_limit=size + 1))
        while len(plain) <= size and not decoder.can_accept_more_data():
            more = bytes(decoder.process(b"", output_buffer_limit=size + 1 - len(plain)))
            if not more:
                break
            plain += more
    return checked(_TITLE, plain, size)


BROTLI = Lossless(_TITLE, f"quality {_QUALITY}", encode, decode)
