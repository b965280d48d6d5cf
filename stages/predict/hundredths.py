"""Intensities that are hundredths, as KITTI's are."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

F32 = NDArray[np.float32]
INTENSITY_OF_LEVEL = (np.arange(101) / 100).astype(np.float32)


@njit(cache=True)
def _levels(
    intensity: F32, bits: NDArray[np.int32], table: NDArray[np.int32]
) -> tuple[NDArray[np.uint8], bool]:
    """Nearest hundredths, and whether their bits (not only their values: -0.0 is none) are those of ``table``."""
    levels = np.empty(len(intensity), np.uint8)
    same = True
    for i in range(len(intensity)):
        hundredths = np.rint(intensity[i] * np.float32(100.0))
        level = np.uint8(hundredths) if 0.0 <= hundredths <= 100.0 else np.uint8(0)
        levels[i] = level
        same &= table[level] == bits[i]
    return levels, same


def intensity_levels(intensity: F32) -> NDArray[np.uint8] | None:
    """Return intensities ``(M,)`` in hundredths, or None where one is not float32 of n / 100."""
    values = np.ascontiguousarray(intensity)
    levels, same = _levels(values, values.view(np.int32), INTENSITY_OF_LEVEL.view(np.int32))
    return levels if same else None
