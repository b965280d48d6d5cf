"""The mask, the ground map and the residuals of range images by one of the nine coders, and all ten by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from salpcc.schemas.grid import COLUMNS, ROWS
from salpcc.stages.entropy.buffer import require_sound
from salpcc.stages.residual_code.paper.grid_context import ContextImages
from salpcc.stages.residual_code.paper.grid_residuals import (
    from_residuals,
    from_symbols,
    ground_first,
    residuals,
    to_symbols,
)
from salpcc.stages.residual_code.paper.image_coder import ImageCoder, Images
from salpcc.stages.residual_code.paper.lossless import CODERS, Lossless

_CELLS = ROWS * COLUMNS
_LENGTH = 3  # bytes of the length of coded symbols


def plain_streams(
    level: NDArray[np.int32], ground: NDArray[np.bool_], images: Images
) -> tuple[bytes, bytes, bytes, bytes]:
    """Return mask, ground map and symbols of a frame, what the nine coders are given, and the bits stored as they are."""
    filled = level > 0
    values = residuals(level, ground, images.plane, images.frame)
    symbols, rest = to_symbols(values[ground_first(ground[filled])])
    return np.packbits(filled).tobytes(), np.packbits(ground[filled]).tobytes(), symbols, rest


@dataclass(frozen=True)
class ByteImages:
    """One of the nine coders: mask and ground map as packed bits, residuals as symbols and plain bits."""

    coder: Lossless

    def encode(
        self, level: NDArray[np.int32], ground: NDArray[np.bool_], images: Images
    ) -> tuple[bytes, bytes, bytes]:
        """Encode a frame; see :class:`ImageCoder`."""
        mask, on_ground, symbols, rest = plain_streams(level, ground, images)
        coded = self.coder.encode(symbols)
        levels = len(coded).to_bytes(_LENGTH, "little") + coded + rest
        return self.coder.encode(mask), self.coder.encode(on_ground), levels

    def decode(
        self, mask: bytes, ground: bytes, levels: bytes, returns: int, images: Images
    ) -> NDArray[np.int32]:
        """Decode a frame; see :class:`ImageCoder`."""
        filled = _bits(self.coder.decode(mask, _CELLS // 8), _CELLS).reshape(ROWS, COLUMNS)
        require_sound(filled.sum() == returns)
        on_ground = np.zeros(filled.shape, np.bool_)
        on_ground[filled] = _bits(self.coder.decode(ground, -(-returns // 8)), returns)
        end = _LENGTH + int.from_bytes(levels[:_LENGTH], "little")
        symbols = self.coder.decode(levels[_LENGTH:end], returns)
        ordered, sound = from_symbols(symbols, levels[end:])
        require_sound(sound)
        values = np.empty_like(ordered)
        values[ground_first(on_ground[filled])] = ordered
        level, sound = from_residuals(values, filled, on_ground, images.plane, images.frame)
        require_sound(sound)
        return level


def _bits(data: bytes, n: int) -> NDArray[np.bool_]:
    return np.unpackbits(np.frombuffer(data, np.uint8), count=n).astype(np.bool_)


IMAGE_CODERS: Mapping[str, Callable[[], ImageCoder]] = {
    "context": ContextImages,
    **{name: partial(ByteImages, coder) for name, coder in CODERS.items()},
}
