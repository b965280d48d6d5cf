"""Intensity in hundredths, given the ranges: adaptive bits against the neighbours' mean.

The return to the left and those of the ring above predict the intensity the better the nearer their
range is; where the range jumps, so does the material. Each bit is coded by the mean of two contexts:
mean and spread of the neighbours, and the laser with the mean, since some lasers are brighter.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.entropy.walks import code_mixed_tree, failed, finish_coder, start_coder, uncounted

LEVELS = 101
_BITS = 7
_TREE = 1 << _BITS
_MEANS = 26
_SPREADS = 6
CONTEXTS = _MEANS * _SPREADS * _TREE
_LASER_MEANS = 16
LASER_CONTEXTS = 256 * _LASER_MEANS * _TREE


@njit(cache=True, error_model="numpy")
def _nearness(a: float, b: float) -> float:
    """Weight of a neighbour at range b for a return at range a."""
    gap = abs(a - b) / (a + b + 1.0)
    return 1.0 / (1.0 + 300.0 * gap)


@njit(cache=True, error_model="numpy")
def _context(
    i: int,
    begin: int,
    above: int,
    j: int,
    level: NDArray[np.int32],
    value: NDArray[np.uint8],
) -> tuple[int, int]:
    """Contexts of return i: mean and spread of its neighbours' intensities; and the mean, coarser."""
    r = float(level[i])
    total = 0.0
    mean = 0.0
    left = np.int64(0)
    if i > begin:
        left = np.int64(value[i - 1])
        weight = 1.5 * _nearness(r, level[i - 1])
        total += weight
        mean += weight * value[i - 1]
        if i - 1 > begin:
            weight = _nearness(r, level[i - 2])
            total += weight
            mean += weight * value[i - 2]
    upper = left
    for u in range(j - 1, j + 3):
        if above <= u < begin:
            weight = _nearness(r, level[u])
            if u == j or u == j + 1:
                weight *= 1.5
            total += weight
            mean += weight * value[u]
    if above <= j < begin:
        upper = np.int64(value[j])
    if total > 0.0:
        mean /= total
    apart = abs(left - mean) + abs(upper - mean)
    spread = 0
    limit = 1.5
    while spread < _SPREADS - 1 and apart > limit:
        limit *= 2.0
        spread += 1
    fine = min(int(mean * 0.25 + 0.5), _MEANS - 1) * _SPREADS + spread
    return fine, min(int(mean * 0.15), _LASER_MEANS - 1)


@uncounted
def _walk(
    writing: bool,
    state: NDArray[np.int64],
    starts: NDArray[np.int64],
    tick: NDArray[np.int32],
    level: NDArray[np.int32],
    value: NDArray[np.uint8],
    model: NDArray[np.uint16],
    by_laser: NDArray[np.uint16],
    buffer: NDArray[np.uint8],
) -> int:
    above = 0
    for k in range(len(starts) - 1):
        begin = starts[k]
        j = above - 1
        for i in range(begin, starts[k + 1]):
            while j + 1 < begin and tick[j + 1] <= tick[i]:
                j += 1
            context, mean = _context(i, begin, above, j, level, value)
            here = (k * _LASER_MEANS + mean) * _TREE
            coded = code_mixed_tree(
                writing, state, buffer, model, context * _TREE, by_laser, here, _BITS, value[i]
            )
            if coded >= LEVELS or failed(state):
                return -1
            value[i] = coded
        if starts[k + 1] > begin:
            above = begin
    return finish_coder(writing, state, buffer)


@njit(cache=True)
def encode_intensity(
    starts: NDArray[np.int64],
    tick: NDArray[np.int32],
    level: NDArray[np.int32],
    value: NDArray[np.uint8],
    model: NDArray[np.uint16],
    by_laser: NDArray[np.uint16],
    out: NDArray[np.uint8],
) -> int:
    """Encode intensities 0..100 ``(M,)``; return the bytes written to ``out``, -1 if full."""
    return _walk(True, start_coder(True, out), starts, tick, level, value.copy(), model, by_laser, out)


@njit(cache=True)
def decode_intensity(
    starts: NDArray[np.int64],
    tick: NDArray[np.int32],
    level: NDArray[np.int32],
    model: NDArray[np.uint16],
    by_laser: NDArray[np.uint16],
    data: NDArray[np.uint8],
) -> tuple[NDArray[np.uint8], bool]:
    """Inverse of :func:`encode_intensity`; the values and whether the data sufficed and made sense."""
    value = np.zeros(len(tick), np.uint8)
    return value, _walk(
        False, start_coder(False, data), starts, tick, level, value, model, by_laser, data
    ) == 0
