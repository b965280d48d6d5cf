"""The points of a layer in the list that the sensor measured: which of it are of this layer, which a reader has already, and which are gone.

:mod:`.aimed_coder` walks over the list as it was measured. A reader of a movable layer has the static one, so nothing is told of its points but where they
come, and the points after them are told from them as from any other. Which place is whose is told in one of two ways:

* In an organised cloud the static layer tells which of its places are left empty (GONE), so rows stay under one another. The places that are left are
  those of the movable layer, unless some of it was taken out.
* Else the static layer is a list of its own, and the movable one tells before each point whether the next static one comes. That follows from the laser that
  is due: where that of the next static point is due, most often nothing is between.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, TypeVar

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.entropy.range_coder import new_bits
from salpcc.stages.entropy.walks import code_mixed_bit
from salpcc.stages.lists.aimed.aimed_neighbours import short_way
from salpcc.stages.lists.aimed.aimed_symbols import AIMED, NAN, ZERO

OWN, GIVEN, GONE = 0, 1, 2  # roles of points
_LASERS = 256
_FITS = 6
_NEXT = _FITS * 4 * 16  # contexts of what comes next
_NEAR = 3**6  # and of what is gone

_T = TypeVar("_T", bound=np.generic)

I64 = NDArray[np.int64]
U8 = NDArray[np.uint8]


def scattered(role: U8, own: NDArray[_T], given: NDArray[_T] | None = None) -> NDArray[_T]:
    """Return what all places of a list have ``(N, …)``: those that are OWN and GIVEN theirs, in order, others 0."""
    whole = np.zeros((len(role), *own.shape[1:]), own.dtype)
    whole[role == OWN] = own
    if given is not None:
        whole[role == GIVEN] = given
    return whole


class Among(NamedTuple):
    """Where the points of a layer stand in a list of ``N``.

    Attributes:
        role: of each point of the list ``(N,)``; of those that are not GIVEN, a reader finds it.
        given: points ``(T, 3)`` of the static layer, where the layer is the movable one.
        own: points of the layer.
        width: of a row, where the list is an organised cloud whose empty places are told; 0: a list in which it is told what comes next.
        timed: lasers and times of those GIVEN ``(T,)``, and for a writer times of those that are OWN, from the same origin; None where they are not told.
    """

    role: U8
    given: NDArray[np.float32]
    own: int
    width: int
    timed: Callable[[], tuple[U8, I64, I64] | None] | None = None

    @classmethod
    def of_source(
        cls,
        n: int,
        own: NDArray[np.int64] | int,
        width: int,
        static: tuple[NDArray[np.int64], NDArray[np.float32]] | None = None,
    ) -> Among:
        """Return it for an organised cloud of ``n`` points.

        Args:
            own: places of the layer's points, or how many there are where a reader is to find them.
            static: places and points of the static layer, where the layer is the movable one.
        """
        role = np.full(n, OWN if isinstance(own, int) else GONE, np.uint8)
        given = np.zeros((0, 3), np.float32)
        if static is not None:
            role[static[0]], given = GIVEN, np.ascontiguousarray(static[1])
        if isinstance(own, int):
            return cls(role, given, own, width)
        role[own] = OWN
        return cls(role, given, len(own), width)

    @classmethod
    def of_list(
        cls,
        own: int,
        static: NDArray[np.float32],
        movable: NDArray[np.bool_] | None = None,
        timed: Callable[[], tuple[U8, I64, I64] | None] | None = None,
    ) -> Among:
        """Return it for ``own`` points of a movable layer; ``movable``: which ``(N,)`` of both layers, where that is known."""
        role = np.full(own + len(static), GIVEN, np.uint8)
        if movable is not None:
            role[movable] = OWN
        return cls(role, static, own, 0, timed)

    def merged(self, points: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return all points ``(N, 3)`` of the list, from those of the layer; zeros for those that are gone."""
        return scattered(self.role, points, self.given)

    def first(self, n: int) -> Among:
        """Return it for the first points of the list."""
        role = self.role[:n].copy()
        given = self.given[: np.count_nonzero(role == GIVEN)]
        return Among(role, given, int(np.count_nonzero(role == OWN)), self.width)


class Layer(NamedTuple):
    """What a walk over a list of ``N`` points takes along of its layers; of none where it has only one.

    Attributes:
        role: of each point ``(N,)``, as far as it is known.
        left: how many that are OWN, and GONE, are to come ``(2,)``.
        organised: whether it is told what is gone; else what comes next.
        points, kinds, laser, tick, level: of those GIVEN ``(T,)``, as :func:`~.aimed_coder.code_aimed` has them.
        bits: contexts. ``history``: of each laser, which of its last points are OWN, as bits.
    """

    role: U8
    left: I64
    organised: bool
    points: NDArray[np.float32]
    kinds: U8
    laser: U8
    tick: I64
    level: I64
    bits: NDArray[np.uint16]
    history: I64


def layer(among: Among, kinds: U8, laser: U8, tick: I64, level: I64) -> Layer:
    """Return layers before the first point of a walk; where those GIVEN are on the lattice is as in :class:`Layer`."""
    left = np.array([among.own, len(among.role) - len(among.given) - among.own])
    return Layer(
        among.role, left, among.width > 0, among.given, kinds, laser, tick, level,
        new_bits(2 * max(_NEXT, _NEAR)), np.zeros(_LASERS, np.int64),
    )  # fmt: skip


def only_layer() -> Layer:
    """Return what stands for the layers where there is one only."""
    none, wide = np.zeros(0, np.uint8), np.zeros(0, np.int64)
    return layer(Among(none, np.zeros((0, 3), np.float32), 0, 0), none, none, wide, wide)


@njit(cache=True, error_model="numpy", _nrt=False)
def code_next(writing, state, data, layer, i, j, due, expected, ticks):  # type: ignore[no-untyped-def]
    """Write the role of point i of a list, or read and return it, where j points that are GIVEN are behind.

    Args:
        due, expected: laser and tick that the walk expects; -1: no laser.
    """
    role, left = layer.role, layer.left
    if j == len(layer.points) or left[0] <= 0:
        own = np.int64(left[0] > 0)
    else:
        fits = 5
        if layer.kinds[j] == AIMED and due < 0:
            fits = 4
        elif layer.kinds[j] == AIMED:
            off = abs(short_way(layer.tick[j] - expected, ticks))
            fits = int(off > 1) + (0 if layer.laser[j] == due else 2)
        history = layer.history[due] if due >= 0 else 0
        before = np.int64(role[i - 1] == OWN) if i > 0 else 0
        earlier = np.int64(role[i - 2] == OWN) if i > 1 else 0
        at = (fits * 4 + before * 2 + earlier) * 16
        own = code_mixed_bit(
            writing, state, data, layer.bits, at + history, layer.bits, _NEXT + at + (history & 1),
            np.int64(role[i] == OWN),
        )  # fmt: skip
    left[0] -= own
    role[i] = OWN if own == 1 else GIVEN
    return role[i]


@njit(cache=True, error_model="numpy", inline="always", _nrt=False)
def _look(role, kinds, j, i):  # type: ignore[no-untyped-def]
    """What is at point j before point i: 2, nothing of the layers; 1, no return; 0, a return, or no point."""
    if j < 0 or j >= i:
        return 0
    return 2 if role[j] == GONE else np.int64(kinds[j] == ZERO or kinds[j] == NAN)


@njit(cache=True, error_model="numpy", _nrt=False)
def code_role(writing, state, data, layer, kinds, i, lag):  # type: ignore[no-untyped-def]
    """Write the role of point i of an organised cloud, or read and return it; ``lag``: how many points back the one beside it is, 0: unknown."""
    role, left = layer.role, layer.left
    if role[i] == GIVEN:
        return GIVEN
    gone = np.int64(left[0] == 0)
    if left[0] > 0 and left[1] > 0:
        near, far = 0, 0
        for j in (i - 1, i - 2, i - 3):
            near = near * 3 + _look(role, kinds, j, i)
        if lag > 0:
            for j in (i - lag - 1, i - lag, i - lag + 1):
                near = near * 3 + _look(role, kinds, j, i)
            for j in (i - 1, i - lag, i - lag + 2, i - 2 * lag, i - 2 * lag + 1):
                far = far * 3 + _look(role, kinds, j, i)
        gone = code_mixed_bit(
            writing, state, data, layer.bits, near, layer.bits, _NEAR + far, np.int64(role[i] == GONE)
        )
    left[gone] -= 1
    role[i] = GONE if gone == 1 else OWN
    return role[i]


@njit(cache=True, error_model="numpy", _nrt=False)
def take(layer, j, i, points, kinds, laser, tick, level):  # type: ignore[no-untyped-def]
    """Let point i of the list be the given point j."""
    kinds[i], laser[i], tick[i], level[i] = layer.kinds[j], layer.laser[j], layer.tick[j], layer.level[j]
    for c in range(3):
        points[i, c] = layer.points[j, c]


@njit(cache=True, error_model="numpy", _nrt=False)
def learn_layer(layer, laser, own):  # type: ignore[no-untyped-def]
    """Take note of a point of a laser, and whether it is OWN."""
    layer.history[laser] = (layer.history[laser] << 1 | np.int64(own)) & 15
