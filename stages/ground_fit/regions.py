"""Regions of ground: azimuth sectors by distance rings, each small enough to be flat."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

SECTORS = 12
RINGS = (0.0, 8.0, 15.0, 25.0, 40.0, np.inf)  # metres


def region_of(points: NDArray[np.float64]) -> NDArray[np.int32]:
    """Return the region ``ring * SECTORS + sector`` of each point ``(N, 3)``."""
    azimuth = np.arctan2(points[:, 1], points[:, 0]) / (2 * np.pi) + 0.5
    sector = np.minimum((azimuth * SECTORS).astype(np.int32), SECTORS - 1)
    ring = np.searchsorted(RINGS, np.hypot(points[:, 0], points[:, 1]), side="right") - 1
    return (ring * SECTORS + sector).astype(np.int32)
