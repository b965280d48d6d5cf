"""What the network sees of one warped frame, and the ranges that its prediction is mixed from.

All whole numbers: features are in 1/128 within +-256 (the network's own scale), offsets are millimetres.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.schemas.grid import COLUMNS, ROWS
from salpcc.stages.predict.paper.st_lstm.warp import COVERED, FILLED, Image

FARTHEST = 2000  # mm, offsets beyond are cut
# Neighbours of a cell in the warped frame whose ranges the prediction may take part of.
NEIGHBOURS = (
    (0, -1), (0, 1), (-1, 0), (1, 0), (-1, -1), (-1, 1), (1, -1), (1, 1), (0, -2), (0, 2), (0, -3), (0, 3),
)  # fmt: skip
N_OFFSETS = len(NEIGHBOURS) + 4  # … the last frame unwarped, the frame before it, the last error, a constant
N_FEATURES = 13
_CONSTANT = 64  # mm
_EDGE = 400  # mm; a neighbour farther off is of another surface, and no part of it helps


@dataclass(frozen=True, eq=False)
class Inputs:
    """Inputs of one step.

    Attributes:
        base: ``(64, 2000)`` int32 mm, the last frame warped; 0 where nothing is near.
        offsets: ``(N_OFFSETS, 64, 2000)`` int16 mm from the base; 0 where there is nothing to take.
        features: ``(N_FEATURES, 64, 2000)`` int16.
    """

    base: Image
    offsets: NDArray[np.int16]
    features: NDArray[np.int16]


@njit(cache=True, error_model="numpy")
def _squash(millimetres: int) -> int:
    """Square root, signed: 2 mm become 8, 2 m become 253."""
    root = int(np.sqrt(32.0 * abs(millimetres)))
    return root if millimetres >= 0 else -root


@njit(cache=True, error_model="numpy")
def _cut(millimetres: int) -> int:
    return min(max(millimetres, -FARTHEST), FARTHEST)


@njit(cache=True, error_model="numpy")
def _gather(
    base: Image,
    status: NDArray[np.uint8],
    last: Image,
    before: Image,
    error: Image,
    neighbours: NDArray[np.int64],
    offsets: NDArray[np.int16],
    features: NDArray[np.int16],
) -> None:
    count = len(neighbours)
    for row in range(ROWS):
        for column in range(COLUMNS):
            here = base[row, column]
            features[12, row, column] = 4 * row
            if here == 0:
                continue
            for k in range(count):
                r = row + neighbours[k, 0]
                there = base[r, (column + neighbours[k, 1]) % COLUMNS] if 0 <= r < ROWS else 0
                if there > 0:
                    if abs(there - here) < _EDGE:
                        offsets[k, row, column] = there - here
                    if k < 4:
                        features[3 + k, row, column] = _squash(_cut(there - here))
            if last[row, column] > 0:
                offsets[count, row, column] = _cut(last[row, column] - here)
                features[10, row, column] = 128
            if before[row, column] > 0:
                offsets[count + 1, row, column] = _cut(before[row, column] - here)
                features[11, row, column] = 128
            offsets[count + 2, row, column] = _cut(error[row, column])
            offsets[count + 3, row, column] = _CONSTANT
            features[0, row, column] = min(int(np.sqrt(np.float64(here))), 256)
            features[1, row, column] = 128 if status[row, column] == COVERED else 0
            features[2, row, column] = 128 if status[row, column] == FILLED else 0
            for k in range(3):
                features[7 + k, row, column] = _squash(offsets[count + k, row, column])


def gather(base: Image, status: NDArray[np.uint8], last: Image, before: Image, error: Image) -> Inputs:
    """Make the inputs of one step; all images ``(64, 2000)`` int32 mm, 0 where empty.

    Args:
        base, status: the last frame warped (:func:`~.warp.warp`).
        last: the last frame as it was.
        before: the frame before it, warped twice.
        error: of the prediction of the last frame.
    """
    offsets = np.zeros((N_OFFSETS, ROWS, COLUMNS), np.int16)
    features = np.zeros((N_FEATURES, ROWS, COLUMNS), np.int16)
    _gather(base, status, last, before, error, np.array(NEIGHBOURS), offsets, features)
    return Inputs(base, offsets, features)


def error_of(last: Image, predicted: Image) -> Image:
    """Return what the prediction of the last frame missed, mm; 0 where either is empty."""
    return np.where((last > 0) & (predicted > 0), last - predicted, 0).astype(np.int32)
