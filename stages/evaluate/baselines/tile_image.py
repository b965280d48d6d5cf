"""The uniform 64 x 2000 range image, eq. (1), that the paper's image-based baselines share.

The grid is uniform and the sensor is not, so directions are off by up to half a cell, and points that fall into
one cell leave one. That is the nature of these baselines, and why none of them bounds the 3-D error.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from salpcc.stages.evaluate.baselines.baseline import NotPossible, Points

ROWS, COLUMNS = 64, 2000
UP, DOWN = np.deg2rad(2.0), np.deg2rad(-24.9)  # the sensor's field of view, 26.9 degrees


def project(points: Points) -> NDArray[np.float64]:
    """Return ranges ``(64, 2000)`` in metres; 0 is empty, the nearest point of a cell stays.

    Raises:
        NotPossible: a point is not finite.
    """
    x, y, z = points[:, :3].astype(np.float64).T
    reach = np.sqrt(x * x + y * y + z * z)
    if not np.isfinite(reach).all():
        raise NotPossible("points that are not finite have no place in a range image")
    x, y, z, reach = (a[reach > 0] for a in (x, y, z, reach))
    row = np.clip((UP - np.arcsin(z / reach)) / (UP - DOWN) * ROWS, 0, ROWS - 1).astype(int)
    column = ((1 - np.arctan2(y, x) / np.pi) / 2 * COLUMNS).astype(int) % COLUMNS
    image = np.zeros((ROWS, COLUMNS))
    order = np.argsort(-reach, kind="stable")
    image[row[order], column[order]] = reach[order]
    return image


def unproject(ranges: NDArray[np.floating[Any]]) -> Points:
    """Return the points ``(M, 3)`` at the centres of the filled cells, row by row."""
    filled = ranges > 0
    return (ranges[filled][:, None] * directions()[filled]).astype(np.float32)


def directions() -> NDArray[np.float64]:
    """Return the unit vectors ``(64, 2000, 3)`` through the centres of the cells."""
    elevation = UP - (np.arange(ROWS)[:, None] + 0.5) / ROWS * (UP - DOWN)
    azimuth = (1 - 2 * (np.arange(COLUMNS) + 0.5) / COLUMNS) * np.pi
    flat = np.cos(elevation)
    z = np.broadcast_to(np.sin(elevation), (ROWS, COLUMNS))
    return np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), z], axis=2)


def to_levels(ranges: NDArray[np.float64], step: float) -> NDArray[np.uint16]:
    """Quantise ranges to 16-bit levels of ``step`` metres; what is filled stays above 0.

    Raises:
        NotPossible: a range does not fit 16 bits at this step.
    """
    levels = np.where(ranges > 0, np.maximum(1, np.rint(ranges / step)), 0)
    if levels.max(initial=0) > 0xFFFF:
        raise NotPossible(f"a range beyond {0xFFFF * step:.0f} m does not fit 16 bits at this step")
    return levels.astype(np.uint16)
