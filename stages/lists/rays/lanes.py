"""The lanes of a list of points: which laser each point may be of, from its elevation alone.

A writer's guess, which no reader repeats: a wrong lane costs bits and nothing else.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_PER_DEGREE = 50
_WIDTH = 4  # cells; of the smoothing, standard deviation
_LOWEST = 0.1  # of the median peak
_FAR = 4.0  # metres; nearer points show where the laser sits instead of its elevation
_MOST = 256


def find_lanes(points: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Return the lane of each point ``(S, 3)``, top first, as uint8 ``(S,)``: the peak of the elevations it is nearest to."""
    with np.errstate(invalid="ignore", over="ignore"):
        x, y, z = points.astype(np.float64).T
        ground = np.hypot(x, y)
        elevation = np.nan_to_num(np.degrees(np.arctan2(z, ground)))
    cell = ((elevation + 90.0) * _PER_DEGREE).astype(np.int64)
    far = ground > _FAR
    counts = np.bincount(cell[far], minlength=180 * _PER_DEGREE + 1).astype(np.float64)
    reach = np.arange(-3 * _WIDTH, 3 * _WIDTH + 1)
    smooth = np.convolve(counts, np.exp(-0.5 * (reach / _WIDTH) ** 2), "same")
    peaks = np.flatnonzero((smooth[1:-1] > smooth[:-2]) & (smooth[1:-1] >= smooth[2:])) + 1
    if not len(peaks):
        return np.zeros(len(points), np.uint8)
    peaks = peaks[smooth[peaks] > _LOWEST * np.median(smooth[peaks])]
    peaks = np.sort(peaks[np.argsort(-smooth[peaks], kind="stable")[:_MOST]])
    middles = (peaks[1:] + peaks[:-1]) / 2.0
    return (len(peaks) - 1 - np.searchsorted(middles, cell)).astype(np.uint8)
