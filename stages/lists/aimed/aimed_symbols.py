"""Kinds and lasers of points in :mod:`.aimed_coder`, and all its contexts."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.entropy.range_coder import new_bits
from salpcc.stages.entropy.residual_bits import PER_CONTEXT, SIZES
from salpcc.stages.entropy.walks import code_mixed_bit
from salpcc.stages.lists.rays.ray_forms import SPREADS

AIMED, ZERO, NAN, OFF = 0, 1, 2, 3
CLASSES = SIZES // 2 + 1  # as contexts

Bits = NDArray[np.uint16]
Models = tuple[Bits, Bits, Bits, Bits, Bits, Bits, Bits, Bits]


def new_models() -> Models:
    """Return fresh contexts: of kinds, lasers, ticks (two), counts (two), and of what the model is off by (two)."""
    pairs = CLASSES * CLASSES * PER_CONTEXT
    return (
        new_bits(64 * 4),
        new_bits(257 * 256),
        new_bits(pairs),
        new_bits(4 * CLASSES * PER_CONTEXT),
        new_bits(SPREADS * PER_CONTEXT),
        new_bits(pairs),
        new_bits(3 * pairs),
        new_bits(3 * 16 * PER_CONTEXT),
    )


@njit(cache=True, error_model="numpy", forceinline=True, _nrt=False)
def code_kind(
    writing: bool,
    state: NDArray[np.int64],
    data: NDArray[np.uint8],
    bits: Bits,
    kinds: NDArray[np.uint8],
    i: int,
    left: int,
    up: int,
) -> int:
    """Write the kind of point i, or read and return it, told from the points before it and at its place of earlier firings."""
    k1 = np.int64(kinds[i - 1]) if i >= 1 else 0
    k2 = np.int64(kinds[i - left]) if left > 0 and i >= left else 0
    k3 = np.int64(kinds[i - up]) if up > 0 and i >= up else 0
    kind = np.int64(kinds[i])
    at = (k1 * 16 + k2 * 4 + k3) * 4
    high = code_mixed_bit(writing, state, data, bits, at, bits, at + 1, kind >> 1)
    low = code_mixed_bit(writing, state, data, bits, at + 2 + high, bits, at + 2 + high, kind & 1)
    return high * 2 + low


@njit(cache=True, error_model="numpy", forceinline=True, _nrt=False)
def code_laser(
    writing: bool,
    state: NDArray[np.int64],
    data: NDArray[np.uint8],
    bits: Bits,
    known: bool,
    before: int,
    laser: int,
) -> int:
    """Where ``known``, the laser is most often the one before at this place; else it depends on the point before."""
    if known:
        if code_mixed_bit(writing, state, data, bits, 0, bits, 0, np.int64(laser != before)) == 0:
            return before
        before = 0
    node = 1
    for b in range(7, -1, -1):
        at = ((0 if known else 1 + before) * 256) + node
        node = node << 1 | code_mixed_bit(writing, state, data, bits, at, bits, at, (laser >> b) & 1)
    return node & 255
