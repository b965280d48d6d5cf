"""Intensities that are hundredths, as KITTI's are."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

INTENSITY_OF_LEVEL = (np.arange(101) / 100).astype(np.float32)


def intensity_levels(intensity: NDArray[np.float32]) -> NDArray[np.uint8] | None:
    """Return intensities ``(M,)`` in hundredths, or None where one is not float32 of n / 100."""
    with np.errstate(invalid="ignore"):
        levels = np.clip(np.nan_to_num(np.rint(intensity * 100.0)), 0, 100).astype(np.uint8)
    same = INTENSITY_OF_LEVEL[levels].view(np.int32) == np.ascontiguousarray(intensity).view(np.int32)
    return levels if bool(same.all()) else None
