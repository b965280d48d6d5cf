"""Per-laser constants and per-ring preparation shared by training, encoder and decoder."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.ingest.trig import TWO_PI, sin_cos
from salpcc.stages.predict.learned.features import PAD, align


@njit(cache=True, error_model="numpy")
def laser_constants(
    theta: NDArray[np.float64], phi0: NDArray[np.float64], d0: NDArray[np.float64]
) -> NDArray[np.float32]:
    """Return (L, 4): counts = c0 / w - c1, tangent of the elevation c2, azimuth offset c3 in ticks."""
    out = np.empty((len(theta), 4), np.float32)
    for k in range(len(theta)):
        s, c = sin_cos(theta[k])
        out[k, 0] = 500.0 / c
        out[k, 1] = d0[k] * 500.0
        out[k, 2] = s / c
        out[k, 3] = phi0[k] * (4000.0 / TWO_PI)
    return out


@njit(cache=True, error_model="numpy")
def step_feature(step: int) -> float:
    """Return a feature that grows with the logarithm of the step, 0 for step 1."""
    value = 0.0
    rest = np.float64(step)
    while rest >= 2.0:
        rest *= 0.5
        value += 1.0
    return (value + rest - 1.0) * 0.5


@njit(cache=True, error_model="numpy")
def height_ratio(tangent: NDArray[np.float32], k: int) -> float:
    """Elevation of laser k - 2 above laser k in units of that of laser k - 1."""
    if k < 2:
        return 2.0
    first = tangent[k - 1] - tangent[k]
    if first < 1e-4:
        first = 1e-4
    ratio = (tangent[k - 2] - tangent[k]) / first
    return min(max(ratio, 1.2), 6.0)
