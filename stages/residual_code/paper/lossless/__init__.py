"""The nine lossless coders that the paper tries on its residuals (Fig. 8), by the name in a configuration."""

from __future__ import annotations

from collections.abc import Mapping

from salpcc.stages.residual_code.paper.lossless.brotli import BROTLI
from salpcc.stages.residual_code.paper.lossless.bzip2 import BZIP2
from salpcc.stages.residual_code.paper.lossless.deflate64 import DEFLATE64
from salpcc.stages.residual_code.paper.lossless.lizard import LIZARD
from salpcc.stages.residual_code.paper.lossless.lossless_coder import Lossless
from salpcc.stages.residual_code.paper.lossless.lz4 import LZ4
from salpcc.stages.residual_code.paper.lossless.lz5 import LZ5
from salpcc.stages.residual_code.paper.lossless.lzma2 import LZMA2
from salpcc.stages.residual_code.paper.lossless.ppmd import PPMD
from salpcc.stages.residual_code.paper.lossless.zstd import ZSTD

CODERS: Mapping[str, Lossless] = {
    "ppmd": PPMD,
    "zstd": ZSTD,
    "lz4": LZ4,
    "bzip2": BZIP2,
    "brotli": BROTLI,
    "lzma2": LZMA2,
    "deflate64": DEFLATE64,
    "lizard": LIZARD,
    "lz5": LZ5,
}

__all__ = ["CODERS", "Lossless"]
