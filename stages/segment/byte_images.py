"""Images of bytes ``(H, W, C)``, the channels of a pixel together: what a network of whole numbers does between its sums."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

F32 = NDArray[np.float32]
I64 = NDArray[np.int64]
U8 = NDArray[np.uint8]


@njit(cache=True)
def to_bytes(features: F32, part: tuple[int, int], step: F32, zero: int, seam: int) -> U8:
    """Turn features ``(H, W, F)``, from and to those of ``part``, into bytes ``(H, W + 2 seam, C)``, ``step`` ``(C,)`` each.

    Columns are repeated at both ends.
    """
    rows, columns, _ = features.shape
    channels = len(step)
    scale = np.float32(1.0) / step
    out = np.empty((rows, columns + 2 * seam, channels), np.uint8)
    for i in range(rows):
        for j in range(columns):
            for c in range(channels):
                value = features[i, j, part[0] + c] * scale[c] + np.float32(zero + 0.5)
                out[i, j + seam, c] = np.uint8(min(max(value, np.float32(0.0)), np.float32(255.0)))
        out[i, :seam] = out[i, columns : columns + seam]
        out[i, columns + seam :] = out[i, seam : 2 * seam]
    return out


@njit(cache=True)
def mixed(rows: F32, parents: I64, weights: F32, height: int, seam: int) -> U8:
    """Mix rows ``(N, C)`` of what points say, in steps, by ``parents`` and ``weights`` ``(H W, 3)`` of the pixels, as :func:`to_bytes`."""
    width, channels = len(parents) // height, rows.shape[1]
    out = np.empty((height, width + 2 * seam, channels), np.uint8)
    for i in range(height):
        for j in range(width):
            n = i * width + j
            first, second, third = parents[n, 0], parents[n, 1], parents[n, 2]
            a, b, c = weights[n, 0], weights[n, 1], weights[n, 2]
            for k in range(channels):
                value = a * rows[first, k] + b * rows[second, k] + c * rows[third, k] + np.float32(0.5)
                out[i, j + seam, k] = np.uint8(min(value, np.float32(255.0)))
        out[i, :seam] = out[i, width : width + seam]
        out[i, width + seam :] = out[i, seam : 2 * seam]
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
