"""What training, encoder and decoder share: the sensors it fits, per-laser constants, ring geometry."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.lattice.sensor_model import SensorModel
from salpcc.stages.lattice.trig import TWO_PI, sin_cos

LASERS = 64
TICKS = 4000


def supports(sensor: SensorModel) -> bool:
    """Whether the learned models fit a sensor: an HDL-64E's ring and tick layout, 2 mm counts."""
    return sensor.n_lasers == LASERS and sensor.ticks_per_turn == TICKS and abs(sensor.count - 0.002) < 1e-6


@njit(cache=True, error_model="numpy")
def _constants(parameters: NDArray[np.float64], count: float) -> NDArray[np.float32]:
    out = np.empty((len(parameters), 5), np.float32)
    for k in range(len(parameters)):
        sine, cosine = sin_cos(parameters[k, 0])
        out[k, 0] = 1.0 / (count * cosine)
        out[k, 1] = parameters[k, 4] / count
        out[k, 2] = sine / cosine
        out[k, 3] = parameters[k, 3] * (TICKS / TWO_PI)
        out[k, 4] = parameters[k, 2]
    return out


def laser_constants(sensor: SensorModel) -> NDArray[np.float32]:
    """Return ``(L, 5)``: counts = c0 / w - c1, tangent of the elevation, azimuth offset in ticks, lever arm."""
    return _constants(sensor.parameters, sensor.count)


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
def height_ratio(constants: NDArray[np.float32], k: int) -> float:
    """Elevation of laser k - 2 above laser k in units of that of laser k - 1."""
    if k < 2:
        return 2.0
    first = max(float(constants[k - 1, 2] - constants[k, 2]), 1e-4)
    ratio = float(constants[k - 2, 2] - constants[k, 2]) / first
    return min(max(ratio, 1.2), 6.0)


@njit(cache=True, error_model="numpy")
def longest_ring(starts: NDArray[np.int64]) -> int:
    """Return the number of returns of the fullest ring."""
    longest = 0
    for k in range(len(starts) - 1):
        longest = max(longest, starts[k + 1] - starts[k])
    return longest
