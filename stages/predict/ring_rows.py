"""Rings as rows with cyclic margins, and one ring moved into the tick frame of another.

The lever arm of docs/sensor_lattice.md, section 1, shifts what a laser sees at a given tick, so a coded ring is
moved before the returns of another laser are predicted from it. Arithmetic as in :mod:`~salpcc.stages.predict.learned.range_features`.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.predict.sweep_walk import longest_ring
from salpcc.stages.vectors import inline

PAD = 8  # returns of a margin
SLACK = 8  # room behind the last margin that vectors may read

_TICKS_PER_RADIAN = np.float32(636.6197723675814)
_EDGE, _SPAN = np.float32(0.06), np.float32(16.0)
_ZERO, _HALF, _ONE = np.float32(0.0), np.float32(0.5), np.float32(1.0)

F32 = NDArray[np.float32]
I32 = NDArray[np.int32]


@njit(cache=True, error_model="numpy")
def row_size(starts: NDArray[np.int64]) -> int:
    """Return how many places a row needs for the longest ring."""
    return longest_ring(starts) + 2 * PAD + SLACK


@njit(cache=True, error_model="numpy", nogil=True)
def place_rings(
    starts: NDArray[np.int64], tick: I32, level: I32, step: int, constants: F32
) -> tuple[F32, F32]:
    """Azimuths and inverse ranges of all rings, each at ``[PAD, PAD + n)`` of its row, margins cyclic."""
    n_rings = len(starts) - 1
    size = row_size(starts)
    azimuth = np.zeros((n_rings, size), np.float32)
    inverse = np.ones((n_rings, size), np.float32)
    middle = np.float32((step - 1) * 0.5)
    for k in range(n_rings):
        lo = starts[k]
        m = starts[k + 1] - lo
        for i in range(m):
            azimuth[k, PAD + i] = np.float32(tick[lo + i]) + constants[k, 3]
            distance = np.float32(level[lo + i] * step) + middle + constants[k, 1]
            inverse[k, PAD + i] = constants[k, 0] / max(distance, _ONE)
        if m:
            for p in range(PAD):
                left, right = PAD + m - 1 - p % m, PAD + p % m
                turns = np.float32(4000.0) * np.float32(1 + p // m)
                azimuth[k, PAD - 1 - p] = azimuth[k, left] - turns
                inverse[k, PAD - 1 - p] = inverse[k, left]
                azimuth[k, PAD + m + p] = azimuth[k, right] + turns
                inverse[k, PAD + m + p] = inverse[k, right]
    return azimuth, inverse


@njit(cache=True, error_model="numpy")
def place_azimuths(starts: NDArray[np.int64], tick: I32, constants: F32) -> F32:
    """Azimuths of all rings, each at ``[PAD, PAD + n)`` of its row, without margins."""
    azimuth = np.zeros((len(starts) - 1, row_size(starts)), np.float32)
    for k in range(len(starts) - 1):
        for i in range(starts[k], starts[k + 1]):
            azimuth[k, PAD + i - starts[k]] = np.float32(tick[i]) + constants[k, 3]
    return azimuth


@inline
def lever_ticks(lever: np.float32) -> np.float32:
    """Return by how many ticks, per inverse range, a difference of two lever arms in metres moves what is seen."""
    return lever * _TICKS_PER_RADIAN


@inline
def follow(frames: F32, ring: int, j: int, end: int, a: np.float32) -> int:
    """Return the last place, from ``j`` on and before ``end``, of a row of azimuths whose returns are not after ``a``."""
    while j + 1 < end and frames[np.uint64(ring), np.uint64(j + 1)] <= a:
        j += 1
    return j


@inline
def across(frames: F32, ring: int, inverse: F32, of: int, j: int, a: np.float32) -> np.float32:
    """Interpolate inverse ranges of a row at azimuth ``a`` between places j and j + 1: linear, or the nearer one across an edge.

    Azimuths are row ``ring`` of ``frames``, ranges row ``of``.
    """
    row, row_of, at, after = np.uint64(ring), np.uint64(of), np.uint64(j), np.uint64(j + 1)
    span = frames[row, after] - frames[row, at]
    t = (a - frames[row, at]) / span if span > _ZERO else _ZERO
    t = min(max(t, _ZERO), _ONE)
    first, second = inverse[row_of, at], inverse[row_of, after]
    difference = second - first
    if abs(difference) > _EDGE * first or span > _SPAN:
        return second if t > _HALF else first
    return first + t * difference


@njit(cache=True, error_model="numpy")
def align(
    azimuth: F32,
    inverse: F32,
    n: int,
    lever: np.float32,
    current: F32,
    m: int,
    frame: F32,
    index: I32,
) -> None:
    """Move a coded ring into the frame of the current one.

    ``lever`` is the difference of the two lever arms in metres. Fills ``frame`` (azimuths of the ring,
    margins included), and for each of the ``m`` current azimuths ``index`` (the last return of the
    ring not after it).
    """
    shift = lever_ticks(lever)
    for i in range(n + 2 * PAD):
        frame[i] = azimuth[i] + shift * inverse[i]
    j = PAD - 1
    last = PAD + n - 1
    for i in range(m):
        a = current[PAD + i]
        while j < last and frame[j + 1] <= a:
            j += 1
        index[i] = j
