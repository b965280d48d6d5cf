"""Mask and levels of the frames of a GOP by contexts; the tenth coder, beside the nine of the paper."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from salpcc.schemas.grid import COLUMNS, ROWS
from salpcc.stages.entropy.buffer import as_array, require_sound, run_encoder
from salpcc.stages.entropy.mixing import EVEN
from salpcc.stages.entropy.range_coder import finish_encoder, start_decoder, start_encoder
from salpcc.stages.residual_code.paper import grid_levels, grid_mask
from salpcc.stages.residual_code.paper.image_coder import Images

_STEEPEST = 3.0  # ratio of the angles between rows
_CLOSEST = 50  # thousandths of a degree between rows that count as apart


class _Learnt:
    """Contexts and weights of one of the walks."""

    def __init__(self, contexts: int, weights: NDArray[np.float64]) -> None:
        self.chances = np.full(contexts, EVEN, np.uint16)
        self.counts = np.zeros(contexts, np.uint8)
        self.weights = weights

    @property
    def arrays(self) -> tuple[NDArray[np.uint16], NDArray[np.uint8], NDArray[np.float64]]:
        return self.chances, self.counts, self.weights


class ContextImages:
    """Codes the frames of a GOP one after the other; see :class:`.image_coder.ImageCoder`.

    It needs no map of the ground: the planes are one more guess in every cell.
    """

    def __init__(self) -> None:
        self._mask = _Learnt(grid_mask.CONTEXTS, grid_mask.first_weights())
        self._levels = _Learnt(grid_levels.CONTEXTS, grid_levels.first_weights())
        self._old = np.zeros((ROWS, COLUMNS), np.bool_)

    def encode(
        self, level: NDArray[np.int32], ground: NDArray[np.bool_], images: Images
    ) -> tuple[bytes, bytes, bytes]:
        """Encode a frame; the ground map is empty."""
        filled = level > 0
        known = images.frame > 0
        frame, plane = _inverse(images.frame), _inverse(images.plane)
        slopes = row_slopes(images.elevation)

        def mask(out: NDArray[np.uint8]) -> int:
            state = start_encoder()
            grid_mask.code_mask(True, state, out, filled, known, self._old, *self._mask.arrays)
            return int(finish_encoder(state, out))

        def levels(out: NDArray[np.uint8]) -> int:
            state = start_encoder()
            grid_levels.code_levels(
                True, state, out, level, filled, frame, plane, images.spread, slopes, images.accuracy,
                *self._levels.arrays,
            )  # fmt: skip
            return int(finish_encoder(state, out))

        of_mask = run_encoder(mask, ROWS * COLUMNS // 8, *self._mask.arrays)
        of_levels = run_encoder(levels, int(filled.sum()), *self._levels.arrays)
        self._old = filled
        return of_mask, b"", of_levels

    def decode(
        self, mask: bytes, ground: bytes, levels: bytes, returns: int, images: Images
    ) -> NDArray[np.int32]:
        """Decode a frame; inverse of :meth:`encode`."""
        data = as_array(mask)
        state = start_decoder(data)
        filled = np.zeros((ROWS, COLUMNS), np.bool_)
        grid_mask.code_mask(False, state, data, filled, images.frame > 0, self._old, *self._mask.arrays)
        require_sound(not ground, state[3] == 0, filled.sum() == returns)
        self._old = filled
        data = as_array(levels)
        state = start_decoder(data)
        level = np.zeros((ROWS, COLUMNS), np.int32)
        sound = grid_levels.code_levels(
            False, state, data, level, filled, _inverse(images.frame), _inverse(images.plane), images.spread,
            row_slopes(images.elevation), images.accuracy, *self._levels.arrays,
        )  # fmt: skip
        require_sound(sound, state[3] == 0)
        return level


def _inverse(level: NDArray[np.int32]) -> NDArray[np.float64]:
    """1/r in levels; 0 where there is none."""
    return np.where(level > 0, 1.0 / np.maximum(level, 1), 0.0)


def row_slopes(elevation: NDArray[np.int16]) -> NDArray[np.float64]:
    """Return the angle from each row to the one above over that between the two above ``(64,)``, 0 where
    there are none or they coincide."""
    angle = elevation.astype(np.float64)
    slopes = np.zeros(ROWS)
    above, below = angle[:-2] - angle[1:-1], angle[1:-1] - angle[2:]
    apart = above > _CLOSEST
    slopes[2:][apart] = np.minimum(below[apart] / above[apart], _STEEPEST)
    return slopes
