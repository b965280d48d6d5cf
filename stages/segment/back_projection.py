"""Labels back to every point: those that a nearer return hides in their pixel, too.

As RangeNet++ does: the k nearest in range among the pixels around vote, weighted by how near.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.schemas.labels import CLASSES
from salpcc.stages.segment.network.range_image import RANGE, RangeImage, wrapped

_WINDOW = 2  # pixels to each side
_NEAREST = 5
_CUTOFF = 1.0  # metres of range
_STEEPNESS = 0.15  # metres added to a difference before it divides the vote
_UNSEEN = 0  # the class of points without a pixel


@njit(cache=True)
def _vote(
    index: NDArray[np.int32],
    shown: NDArray[np.float32],
    classes: NDArray[np.uint8],
    row: NDArray[np.int32],
    column: NDArray[np.int32],
    distance: NDArray[np.float32],
    n_classes: int,
) -> NDArray[np.uint8]:
    rows, columns = classes.shape
    out = np.zeros(len(row), np.uint8)
    votes = np.zeros(n_classes)
    nearest = np.empty(_NEAREST)
    voter = np.empty(_NEAREST, np.int64)
    for i in range(len(row)):
        r, c = row[i], column[i]
        if r < 0:
            out[i] = _UNSEEN
            continue
        if index[r, c] == i:
            out[i] = classes[r, c]
            continue
        nearest[:] = np.inf
        voter[:] = -1
        for a in range(max(r - _WINDOW, 0), min(r + _WINDOW, rows - 1) + 1):
            for step in range(-_WINDOW, _WINDOW + 1):
                b = wrapped(c + step, columns)
                if index[a, b] < 0:
                    continue
                off = abs(shown[a, b] - distance[i])
                k = _NEAREST
                while k > 0 and off < nearest[k - 1]:
                    if k < _NEAREST:
                        nearest[k] = nearest[k - 1]
                        voter[k] = voter[k - 1]
                    k -= 1
                if k < _NEAREST:
                    nearest[k] = off
                    voter[k] = classes[a, b]
        votes[:] = 0.0
        for k in range(_NEAREST):
            if voter[k] >= 0 and (k == 0 or nearest[k] < _CUTOFF):
                votes[voter[k]] += 1.0 / (_STEEPNESS + nearest[k])
        out[i] = np.argmax(votes)
    return out


def classes_of_points(image: RangeImage, classes: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return a class per point ``(N,)`` from the classes ``(64, W)`` of the pixels.

    A point that its pixel shows takes the pixel's class, a hidden one what its neighbours in range vote,
    one without a pixel (NaN, out of reach) is unlabelled.
    """
    shown = np.ascontiguousarray(image.planes[RANGE])
    return _vote(image.index, shown, classes, image.row, image.column, image.distance, len(CLASSES))
