"""General-purpose compressors on the raw float32 file: xz, zstd, brotli, bzip2."""

from __future__ import annotations

import bz2
import lzma
from collections.abc import Callable

import numpy as np

from salpcc.stages.evaluate.baselines.baseline import Baseline, NotPossible, Points, Promise

EXACT = Promise(bound="exact", order=True, count=True, intensity=True)


def to_file(points: Points, max_error: float) -> bytes:
    """Return the file as it would lie on disk, behind one byte with its number of columns.

    Raises:
        NotPossible: an error above 0 is asked; these compressors know nothing but bytes.
    """
    if max_error > 0:
        raise NotPossible("a byte compressor is bit-exact only")
    return bytes([points.shape[1]]) + np.ascontiguousarray(points, np.float32).tobytes()


def from_file(data: bytes) -> Points:
    """Return the points of :func:`to_file`."""
    return np.frombuffer(data, np.float32, offset=1).reshape(-1, data[0]).copy()


def _baseline(
    title: str,
    packages: tuple[str, ...],
    compress: Callable[[bytes], bytes],
    expand: Callable[[bytes], bytes],
) -> Baseline:
    return Baseline(
        title=title,
        packages=packages,
        promise=EXACT,
        encode=lambda points, max_error: compress(to_file(points, max_error)),
        decode=lambda data: from_file(expand(data)),
    )


def _zstd_compress(data: bytes) -> bytes:
    import zstandard

    return zstandard.ZstdCompressor(level=19).compress(data)


def _zstd_expand(data: bytes) -> bytes:
    import zstandard

    return zstandard.ZstdDecompressor().decompress(data)


def _brotli_compress(data: bytes) -> bytes:
    import brotli

    return bytes(brotli.compress(data, quality=11))


def _brotli_expand(data: bytes) -> bytes:
    import brotli

    return bytes(brotli.decompress(data))


XZ = _baseline("xz -6", (), lambda data: lzma.compress(data, preset=6), lzma.decompress)
BZIP2 = _baseline("bzip2 -9", (), lambda data: bz2.compress(data, 9), bz2.decompress)
ZSTD = _baseline("zstd -19", ("zstandard",), _zstd_compress, _zstd_expand)
BROTLI = _baseline("brotli -11", ("brotli",), _brotli_compress, _brotli_expand)
