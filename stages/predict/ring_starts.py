"""Where the rings of a sweep start."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def ring_starts(laser: NDArray[np.uint8], lasers: int) -> NDArray[np.int64]:
    """Return where each ring starts among returns in firing order, ``(L + 1,)`` int64."""
    # Of the same type, or all of ``laser`` would be converted.
    return np.append(np.searchsorted(laser, np.arange(lasers, dtype=np.uint8)), len(laser))
