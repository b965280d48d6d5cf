"""Which cells of a range image are filled: one mixed bit a cell, in the context of cells around and before."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.schemas.grid import COLUMNS, ROWS
from salpcc.stages.entropy.mixing import code_learned_bit

_SIZES = np.array([1 << 11, 1 << 11, 1 << 12, 1 << 11, ROWS << 4])
_FIRST = np.concatenate([np.zeros(1, np.int64), np.cumsum(_SIZES)])
CONTEXTS = int(_FIRST[-1])
MIXERS = 64
OPINIONS = 1 + len(_SIZES)
_RATE = 0.004


def first_weights() -> NDArray[np.float64]:
    """Return the weights of opinions to start from, ``(MIXERS, OPINIONS)``."""
    weights = np.full((MIXERS, OPINIONS), 0.3)
    weights[:, 0] = 0.0
    return weights


@njit(cache=True, error_model="numpy")
def _cells(image: NDArray[np.bool_], row: int, column: int, first: int, last: int) -> int:
    """Bits of the cells ``first`` to ``last`` columns from a cell, the first the most significant."""
    bits = 0
    for c in range(column + first, column + last + 1):
        bits = bits << 1 | (1 if row >= 0 and 0 <= c < COLUMNS and image[row, c] else 0)
    return bits


@njit(cache=True, error_model="numpy")
def code_mask(
    writing: bool,
    state: NDArray[np.int64],
    buffer: NDArray[np.uint8],
    filled: NDArray[np.bool_],
    frame: NDArray[np.bool_],
    old: NDArray[np.bool_],
    chances: NDArray[np.uint16],
    counts: NDArray[np.uint8],
    weights: NDArray[np.float64],
) -> None:
    """Code the mask ``(64, 2000)``; encoder and decoder are one walk, and the decoder writes it.

    Args:
        frame: where the predicted frame has a level.
        old: the mask of the frame before.
    """
    opinions = np.zeros(OPINIONS)
    places = np.zeros(len(_SIZES), np.int64)
    opinions[0] = 0.3
    for row in range(ROWS):
        for column in range(COLUMNS):
            left = _cells(filled, row, column, -6, -1)
            up = _cells(filled, row - 1, column, -2, 2)
            up2 = _cells(filled, row - 2, column, -1, 1)
            three = _cells(frame, row, column, -1, 1)
            was = _cells(old, row, column, -2, 2)
            places[0] = _FIRST[0] + (left << 5 | up)
            places[1] = _FIRST[1] + ((left & 7) << 8 | up << 3 | up2)
            places[2] = _FIRST[2] + (
                ((left & 3) << 10) | (up >> 1 & 7) << 7 | three << 4 | _cells(filled, row - 3, column, -1, 0) << 2
                | (up2 >> 1 & 1) << 1 | (1 if row > 0 and was & 4 else 0)
            )  # fmt: skip
            places[3] = _FIRST[3] + (was << 6 | (left & 3) << 4 | (up >> 1 & 7) << 1 | (three >> 1 & 1))
            places[4] = _FIRST[4] + (row << 4 | (left & 1) << 3 | (up >> 1 & 7))
            bit = code_learned_bit(
                writing, state, buffer, 1 if filled[row, column] else 0, opinions, 1, places, chances, counts,
                weights[(left & 3) << 4 | (up >> 1 & 7) << 1 | (three >> 1 & 1)], _RATE,
            )  # fmt: skip
            if not writing:
                filled[row, column] = bit == 1
