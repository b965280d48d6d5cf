"""Images of bytes ``(H, W, C)``, the channels of a pixel together: what a network of whole numbers does between its sums."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.segment.network.bfloat16 import Numbers, take

U8 = NDArray[np.uint8]


@njit(cache=True)
def rounded(image: Numbers) -> U8:
    """Return numbers ``(H, W, C)``, none of them below 0, as bytes: 255 at most."""
    out = np.empty(image.shape, np.uint8)
    numbers = np.empty(image[0].size, np.float32)
    for i in range(len(image)):
        take(image[i].ravel(), numbers)
        row = out[i].ravel()
        for k in range(len(numbers)):
            row[k] = np.uint8(min(np.rint(numbers[k]), np.float32(255)))
    return out


@njit(cache=True)
def halved(image: U8) -> U8:
    """Return the largest of each channel in every two by two pixels: ``(H / 2, W / 2, C)``."""
    rows, columns, channels = image.shape
    out = np.empty((rows // 2, columns // 2, channels), np.uint8)
    for i in range(rows // 2):
        for j in range(columns // 2):
            for c in range(channels):
                out[i, j, c] = max(
                    max(image[2 * i, 2 * j, c], image[2 * i, 2 * j + 1, c]),
                    max(image[2 * i + 1, 2 * j, c], image[2 * i + 1, 2 * j + 1, c]),
                )
    return out


@njit(cache=True)
def lifted(low: U8, skip: U8) -> U8:
    """Repeat the pixels of ``low`` ``(H / 2, W / 2, C)`` two by two and add half of ``skip`` ``(H, W, C)``; 255 at most."""
    rows, columns, channels = skip.shape
    out = np.empty_like(skip)
    for i in range(rows):
        for j in range(columns):
            for c in range(channels):
                value = np.uint16(skip[i, j, c])
                half = (value + (value >> np.uint16(1) & np.uint16(1))) >> np.uint16(
                    1
                )  # to even, or sums shift
                out[i, j, c] = np.uint8(min(np.uint16(low[i // 2, j // 2, c]) + half, np.uint16(255)))
    return out
