"""Where the rings of a sweep start."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def ring_starts(laser: NDArray[np.uint8], lasers: int) -> NDArray[np.int64]:
    """Return where each ring starts among returns in firing order, ``(L + 1,)`` int64."""
    return np.searchsorted(laser, np.arange(lasers + 1)).astype(np.int64)
