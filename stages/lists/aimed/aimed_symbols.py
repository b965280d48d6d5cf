"""Kinds and lasers of points in :mod:`.aimed_coder`, and all its contexts."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.entropy.range_coder import new_bits
from salpcc.stages.entropy.residual_bits import CLASSES, PER_CONTEXT
from salpcc.stages.entropy.walks import code_mixed_bit, code_mixed_tree
from salpcc.stages.lists.rays.ray_forms import SPREADS

AIMED, ZERO, NAN, OFF = 0, 1, 2, 3
NOBODY = 255  # no laser, of those that came next
HITS = 64  # histories of "the laser that was due came", as contexts
_DUE = 2 * (257 + HITS)  # contexts of "it is this one", behind those of other lasers
FAR = 16  # classes of distance, as contexts of corrections

Bits = NDArray[np.uint16]
Models = tuple[Bits, ...]


def new_models() -> Models:
    """Return fresh contexts: of kinds, lasers, ticks (two), counts (two), whether the model is off, and by what (two)."""
    pairs = CLASSES * CLASSES * PER_CONTEXT
    return (
        new_bits(64 * 4),
        new_bits(257 * 256 + _DUE),
        new_bits(pairs),
        new_bits(4 * CLASSES * PER_CONTEXT),
        new_bits(SPREADS * PER_CONTEXT),
        new_bits(pairs),
        new_bits(16 + FAR),
        new_bits(3 * pairs),
        new_bits(3 * FAR * PER_CONTEXT),
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
    if code_mixed_bit(writing, state, data, bits, at, bits, at, np.int64(kind != AIMED)) == 0:
        return AIMED
    if code_mixed_bit(writing, state, data, bits, at + 1, bits, at + 1, np.int64(kind != ZERO)) == 0:
        return ZERO
    return NAN + code_mixed_bit(writing, state, data, bits, at + 2, bits, at + 2, np.int64(kind == OFF))


@njit(cache=True, error_model="numpy", inline="always", _nrt=False)
def due_lasers(after, pairs, laser, recent, earlier):  # type: ignore[no-untyped-def]
    """Return the two lasers most likely next after the points ``recent`` and ``earlier`` (-1: none); -1: none.

    Args:
        after: of each laser, the two that last came after it ``(L, 2)``; -1: none.
        pairs: of each laser and the one before it, the one that last came after both ``(L, L)``; NOBODY: none.
    """
    last, other = after[laser[recent], 0], after[laser[recent], 1]
    of_both = np.int64(pairs[laser[recent], laser[earlier]]) if earlier >= 0 else NOBODY
    return (last, other) if of_both in (NOBODY, last) else (of_both, last)


@njit(cache=True, error_model="numpy", inline="always", _nrt=False)
def learn_after(after, pairs, laser, recent, earlier, k):  # type: ignore[no-untyped-def]
    """Take note that laser ``k`` came next."""
    if earlier >= 0:
        pairs[laser[recent], laser[earlier]] = k
    before = laser[recent]
    if after[before, 0] != k:
        after[before, 0], after[before, 1] = k, after[before, 0]


@njit(cache=True, error_model="numpy", forceinline=True, _nrt=False)
def code_laser(
    writing: bool,
    state: NDArray[np.int64],
    data: NDArray[np.uint8],
    bits: Bits,
    due: int,
    second: int,
    before: int,
    hits: int,
    laser: int,
) -> int:
    """Write the laser of a point, or read and return it: most often the one that is ``due``, or the ``second`` (-1: none); else it depends on the one ``before`` (-1: none).

    Args:
        hits: whether those due lately came, as bits below HITS.
    """
    for way in range(2):
        one = due if way == 0 else second
        if one >= 0:
            at = 257 * 256 + way * (257 + HITS)
            other = np.int64(laser != one)
            if code_mixed_bit(writing, state, data, bits, at + 1 + before, bits, at + 257 + hits, other) == 0:
                return one
    row = (1 + before) * 256
    return code_mixed_tree(writing, state, data, bits, row, bits, row, 8, laser)
