"""Which laser comes next in a list of firings with gaps, and at which tick, as efforts above ``fast`` learn it.

The laser is most often one of the last three different ones that came after the one before. The tick is guessed as for ``fast``, as that
of the point before, and as the laser's own last one; what holds is told from how often it lately did.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.entropy.mixed_numbers import (
    NODES,
    Guesses,
    Numbers,
    code_mixed_number,
    code_told_bit,
    first_places,
    learn_trust,
    new_guesses,
    new_numbers,
    weigh,
)
from salpcc.stages.entropy.residual_bits import size_of
from salpcc.stages.entropy.walks import Buffer, State
from salpcc.stages.lists.aimed.aimed_neighbours import short_way

_LASERS = 256
_CANDIDATES = 3
_FLAG_NODES = 4  # of contexts of flags: of each candidate, and of the tick
_LONG_AGO = -(1 << 20)
_NEXT = (_LASERS, 64, 13 * 8, _LASERS, 32)  # contexts of "it is this one"
_FIRST_NEXT = first_places(_NEXT)
_TICKS = (256, 5 * 256, _LASERS, 256, _LASERS)  # and of ticks
_FIRST_TICK = first_places(_TICKS)
_AFTER_NEXT = int(_FIRST_NEXT[-1])
_TICK_GUESSES = 4
_SURE, _UNSURE = 4.0, 0.3  # 1 / width of guesses, in ticks

I64 = NDArray[np.int64]
F64 = NDArray[np.float64]


class OrderModels(NamedTuple):
    """What outlives a sweep.

    Attributes:
        after: lasers that came after each ``(256, 3)``, the last first; -1 for none.
        flags: of "it is this one" and of "not the tick that was expected".
        ticks: of other ticks; ``trust (1, 4)`` in their guesses.
    """

    after: I64
    flags: Numbers
    ticks: Numbers
    trust: F64


class OrderSeen(NamedTuple):
    """What a sweep has shown so far, and room to work in.

    Attributes:
        heard, last_tick: of each laser ``(256,)``, the point it last came with, and its tick (-1: none).
        hits: of each laser, whether the first after it came after it, the last eight times as bits; ``recent``: of all of them, and of ticks
            two bits a point.
        sizes: of each pair of lasers ``(256, 256)``, the size of the last miss; ``size (1,)`` of the last of all.
    """

    heard: I64
    last_tick: I64
    hits: I64
    recent: I64
    sizes: NDArray[np.uint8]
    size: I64
    places: I64
    opinions: F64
    guesses: Guesses


def new_order_models() -> OrderModels:
    """Return fresh models."""
    ticks = int(_FIRST_TICK[-1])
    return OrderModels(
        np.full((_LASERS, _CANDIDATES), -1),
        new_numbers(_AFTER_NEXT + ticks, 2, len(_NEXT), _FLAG_NODES),
        new_numbers(ticks, 1, len(_TICKS)),
        np.ones((1, _TICK_GUESSES)),
    )


def nothing_seen() -> OrderSeen:
    """Return what is known before the first point of a sweep."""
    return OrderSeen(
        np.full(_LASERS, _LONG_AGO),
        np.full(_LASERS, -1),
        np.zeros(_LASERS, np.int64),
        np.zeros(2, np.int64),
        np.zeros((_LASERS, _LASERS), np.uint8),
        np.zeros(1, np.int64),
        np.zeros(len(_NEXT), np.int64),
        np.zeros(len(_NEXT)),
        new_guesses(_TICK_GUESSES),
    )


@njit(cache=True, error_model="numpy", inline="always", _nrt=False)
def code_candidate(
    writing: bool,
    state: State,
    data: Buffer,
    models: OrderModels,
    seen: OrderSeen,
    i: int,
    before: int,
    earlier: int,
    laser: int,
) -> int:
    """Write the laser of point i, or read and return it, if it is a candidate; -1 if it is none.

    Args:
        before, earlier: lasers of the point before and of the one before that.
    """
    places, after = seen.places, models.after
    hits, all_hits = seen.hits[before] & 7, seen.recent[0]
    for c in range(_CANDIDATES):
        candidate = after[before, c]
        if candidate < 0:
            break
        age = min(size_of(i - seen.heard[candidate]), 12)
        kin = np.int64(after[candidate, 0] == earlier) + 2 * np.int64(candidate == before)
        kin += 4 * np.int64(candidate == earlier)
        places[0] = before
        places[1] = _FIRST_NEXT[1] + hits * 8 + (all_hits & 7)
        places[2] = _FIRST_NEXT[2] + age * 8 + (all_hits & 7)
        places[3] = _FIRST_NEXT[3] + candidate
        places[4] = _FIRST_NEXT[4] + kin * 4 + (all_hits & 3)
        for flag in range(len(places)):
            places[flag] *= _FLAG_NODES
        it = code_told_bit(
            writing, state, data, np.int64(laser == candidate), 0.0, c, models.flags, places, 0, seen.opinions
        )
        if it == 1:
            return candidate
    return -1


@njit(cache=True, error_model="numpy", inline="always", _nrt=False)
def learn_order(models: OrderModels, seen: OrderSeen, i: int, before: int, laser: int) -> None:
    """Take note that point i is of ``laser``, after one of laser ``before``."""
    after = models.after
    hit = np.int64(after[before, 0] == laser)
    if hit == 0:
        if after[before, 1] != laser:
            after[before, 2] = after[before, 1]
        after[before, 1] = after[before, 0]
        after[before, 0] = laser
    seen.hits[before] = (seen.hits[before] * 2 + hit) & 255
    seen.recent[0] = (seen.recent[0] * 2 + hit) & 255
    seen.heard[laser] = i


@njit(cache=True, error_model="numpy", inline="always", _nrt=False)
def code_tick(
    given: bool,
    writing: bool,
    state: State,
    data: Buffer,
    models: OrderModels,
    seen: OrderSeen,
    before: int,
    laser: int,
    expected: int,
    known: bool,
    tick_before: int,
    turn: int,
    off: int,
) -> int:
    """Write by how many ticks the point of ``laser`` after one of laser ``before`` is off the ``expected`` one, or read and return it.

    Args:
        given: it is known already, and only taken note of.
        known: this pair of lasers was seen before.
        tick_before: of the point before; ``turn``: ticks in one.
    """
    places, guesses, trust = seen.places, seen.guesses, models.trust
    same = short_way(tick_before - expected, turn)
    own = seen.last_tick[laser]
    again = short_way(own - expected, turn) if own >= 0 else 0
    kind = 0 if same == 0 else (1 if same > 0 else 2)
    kind += 2 if abs(same) > 4 else 0
    past = seen.recent[1]
    places[0] = seen.sizes[before, laser] * 16 + seen.size[0]
    places[1] = _FIRST_TICK[1] + past * 5 + kind
    places[2] = _FIRST_TICK[2] + before
    places[3] = _FIRST_TICK[3] + np.int64(known) * 64 + kind * 8 + np.int64(again == 0) * 4 + (past & 3)
    places[4] = _FIRST_TICK[4] + laser
    for c in range(len(places)):
        places[c] = (_AFTER_NEXT + places[c]) * _FLAG_NODES
    other = np.int64(0)
    if not given:
        other = code_told_bit(
            writing, state, data, np.int64(off != 0), 0.0, 0, models.flags, places, 1, seen.opinions
        )
    if other == 0:
        off = off if given else 0
    else:
        guesses.mean[0], guesses.mean[1], guesses.mean[2], guesses.mean[3] = 0.0, same, again, 0.0
        for j in range(_TICK_GUESSES):
            guesses.per[j] = _SURE if j < _TICK_GUESSES - 1 else _UNSURE
            guesses.weight[j] = trust[0, j]
        weigh(guesses, _TICK_GUESSES, 0.0)
        for c in range(len(places)):
            places[c] = (places[c] // _FLAG_NODES - _AFTER_NEXT) * NODES
        off = code_mixed_number(
            writing, state, data, off, 0.0, guesses, _TICK_GUESSES, models.ticks, places, 0, seen.opinions
        )
        off = min(max(off, -turn), turn)
        learn_trust(off, guesses, _TICK_GUESSES, trust, 0)
    size = min(size_of(abs(off)), 15)
    seen.sizes[before, laser] = size
    seen.size[0] = size
    seen.recent[1] = (past * 4 + 2 * np.int64(off != 0) + np.int64(off != same)) & 255
    seen.last_tick[laser] = (expected + off) % turn
    return off
