"""The points of a movable layer among those of the static one, which a reader has: which come next, and what of the walk is known.

Both layers are one list, as the sensor measured it; :mod:`.aimed_coder` walks over all of it. At a point of the static layer nothing is told but that it
comes next, and the points after it are told from it as from any other. Whether it comes next follows from the laser that is
due: where that of the next static point is due, most often nothing is between.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.entropy.range_coder import new_bits
from salpcc.stages.entropy.walks import code_mixed_bit
from salpcc.stages.strays.aimed.aimed_neighbours import short_way
from salpcc.stages.strays.aimed.aimed_symbols import AIMED

_LASERS = 256
_FITS = 6
_CONTEXTS = _FITS * 4 * 16

I64 = NDArray[np.int64]
U8 = NDArray[np.uint8]


class Beside(NamedTuple):
    """The static layer ``(T,)`` beside a movable one of ``M`` points, ``S`` in all; without points where there is one layer only.

    Attributes:
        movable: ``(S,)`` 1 for points of the movable layer, as they become known.
        points, kinds, laser, tick, level: of the static layer, as :func:`~.aimed_coder.code_aimed` has them.
        bits: contexts of what comes next. ``history``: of each laser, which of its last points were movable, as bits; ``after``: the laser that last came after each.
    """

    movable: U8
    points: NDArray[np.float32]
    kinds: U8
    laser: U8
    tick: I64
    level: I64
    bits: NDArray[np.uint16]
    history: I64
    after: I64


def beside(movable: U8, points: NDArray[np.float32], kinds: U8, laser: U8, tick: I64, level: I64) -> Beside:
    """Return a static layer before the first point of a walk."""
    return Beside(
        movable, points, kinds, laser, tick, level,
        new_bits(2 * _CONTEXTS), np.zeros(_LASERS, np.int64), np.full(_LASERS, -1),
    )  # fmt: skip


def nothing_beside() -> Beside:
    """Return what stands for the static layer where there is one layer only."""
    none, wide = np.zeros(0, np.uint8), np.zeros(0, np.int64)
    return beside(none, np.zeros((0, 3), np.float32), none, none, wide, wide)


@njit(cache=True, error_model="numpy", _nrt=False)
def code_layer(writing, state, data, static, i, j, due, expected, ticks):  # type: ignore[no-untyped-def]
    """Write or read whether point i of both layers is a movable one, where j static ones are behind.

    Args:
        due, expected: laser and tick that the walk expects; -1: no laser.
    """
    left = len(static.movable) - i - (len(static.points) - j)  # of the movable layer
    if j == len(static.points) or left <= 0:
        movable = np.int64(left > 0)
    else:
        fits = 5
        if static.kinds[j] == AIMED and due < 0:
            fits = 4
        elif static.kinds[j] == AIMED:
            off = abs(short_way(static.tick[j] - expected, ticks))
            fits = int(off > 1) + (0 if static.laser[j] == due else 2)
        history = static.history[due] if due >= 0 else 0
        before = np.int64(static.movable[i - 1]) if i > 0 else 0
        earlier = np.int64(static.movable[i - 2]) if i > 1 else 0
        at = (fits * 4 + before * 2 + earlier) * 16
        movable = code_mixed_bit(
            writing, state, data, static.bits, at + history, static.bits, _CONTEXTS + at + (history & 1),
            np.int64(static.movable[i]),
        )  # fmt: skip
    static.movable[i] = movable
    return movable


@njit(cache=True, error_model="numpy", _nrt=False)
def take(static, j, i, points, kinds, laser, tick, level):  # type: ignore[no-untyped-def]
    """Let point i of both layers be point j of the static one."""
    kinds[i], laser[i], tick[i], level[i] = static.kinds[j], static.laser[j], static.tick[j], static.level[j]
    for c in range(3):
        points[i, c] = static.points[j, c]


@njit(cache=True, error_model="numpy", _nrt=False)
def learn_layer(static, i, laser, before):  # type: ignore[no-untyped-def]
    """Take note of the layer of point i, of a laser that came after another; -1: after none."""
    static.history[laser] = (static.history[laser] << 1 | np.int64(static.movable[i])) & 15
    if before >= 0:
        static.after[before] = laser
