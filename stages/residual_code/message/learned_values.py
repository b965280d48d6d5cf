"""The value of a column that looks like a picture as efforts above ``fast`` learn it: a mixture of what lies around it and of the scan before.

The neighbours are those of :mod:`.blended_values`, each a guess of its own beside all of them together; where there was something at the same place of
the scan before, at as far away, that is a guess, too. Ranges are known all round, those of the laser's next point as well.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.entropy.mixed_numbers import (
    NODES,
    Guesses,
    Numbers,
    code_mixed_number,
    copied,
    first_places,
    learn_trust,
    new_guesses,
    new_numbers,
    weigh,
)
from salpcc.stages.lists.aimed.aimed_neighbours import link, nearest_of
from salpcc.stages.lists.learned.learned_counts import bucket_by, signed_bucket
from salpcc.stages.lists.timeline import Passed

AROUND = 7  # values looked at, the last by the guide
_MOST = AROUND + 2 + 2
_SPREADS, _VALUES, _SIGNED, _LASERS = 16, 512, 9, 257
_COARSE = _SPREADS // 2
_PAIRS = _SIGNED * _SIGNED * _COARSE
_CONTEXTS = (_VALUES, _PAIRS, _PAIRS, _PAIRS)
_FIRST = first_places(_CONTEXTS)
_NEAR = 0.0005  # turns; what was farther off in the scan before says nothing
_ALIKE = 0.01  # of the distance
_UNKNOWN = 20.0
_LARGEST = 1 << 33

I64 = NDArray[np.int64]
F64 = NDArray[np.float64]
Flags = NDArray[np.bool_]


class Picture(NamedTuple):
    """A column of a scan ``(n,)``: ticks (none in an organised cloud), values, ranges, void ones; the rings of lasers (:func:`link`)."""

    tick: F64
    values: I64
    ranges: F64
    void: Flags
    links: I64
    ends: I64


class ValueModels(NamedTuple):
    """Contexts, and the trust in guesses ``(1, guesses)``."""

    numbers: Numbers
    trust: F64


class ValueWalk(NamedTuple):
    """What a walk over a column takes along.

    Attributes:
        turn: ticks in one; 0: an organised cloud, whose places are those of the scan before.
        before, own: the scan before, and this one; ``cursor (257, 1)`` goes along with the former.
        there: where points were in the scan before ``(n,)``, -1: nowhere; empty where that is not told.
        off: of each point ``(n,)`` how far off the scan before was; ``missed (n,)`` how far off the centre it was, in spreads.
        following: of each point the next one of its laser or row; -1: none.
        apart, alike: of what lies around ``(AROUND,)``: how far apart the ranges are, and what it counts.
    """

    models: ValueModels
    turn: int
    before: Picture
    own: Picture
    cursor: I64
    there: I64
    off: NDArray[np.float32]
    missed: NDArray[np.float32]
    following: I64
    apart: F64
    alike: F64
    guesses: Guesses
    places: I64
    opinions: F64


@njit(cache=True)
def _following(laser: I64, void: Flags, width: int) -> I64:
    """Return the next point ``(n,)`` of each one's laser, or row of an organised cloud; -1: none."""
    n = len(void)
    found = np.full(n, -1)
    last = np.full(_LASERS, -1)
    for i in range(n - 1, -1, -1):
        if void[i]:
            continue
        if width > 0:
            found[i] = i + 1 if i % width < width - 1 and not void[i + 1] else -1
        else:
            found[i] = last[laser[i]]
            last[laser[i]] = i
    return found


@njit(cache=True, error_model="numpy", inline="always", _nrt=False)
def _find_before(walk: ValueWalk, i: int, k: int) -> int:
    """The place in the scan before that is that of point i of laser k; -1: none."""
    before = walk.before
    if len(walk.there) > 0:
        return walk.there[i]
    if walk.turn == 0:
        same = len(before.values) == len(walk.own.values) and not before.void[i]
        return i if same else -1
    if len(before.values) == 0 or before.ends[k, 1] < 0:
        return -1
    at, off = nearest_of(
        walk.own.tick[i], k, walk.cursor, k, 0, walk.turn, before.tick, before.links, before.ends
    )
    return at if abs(off) < _NEAR * walk.turn else -1


@njit(cache=True, error_model="numpy", inline="always", _nrt=False)
def code_learned_value(  # type: ignore[no-untyped-def]
    writing, state, data, walk: ValueWalk, i, k, near, off, stray, mean, expected, spread, values, missed, ranges, value
):  # fmt: skip
    """Write the value of point i, or read and return it.

    Args:
        k: its laser, where ``walk`` has them.
        near: points around ``(AROUND,)``, -1: none; ``off``: by how much their values are off ``mean``; ``stray``: how far off the guide is, -1 without.
        expected, spread: what they say together, and how far off that may be.
        values, missed, ranges: of all points so far; ranges of all.
    """
    guesses, trust, places = walk.guesses, walk.models.trust, walk.places
    n, total = AROUND, 0.0
    for j in range(AROUND):
        known = near[j] >= 0 or (j == AROUND - 1 and stray >= 0.0)
        at = mean + off[j]
        wide = 0.0
        if known:
            wide = 0.5 * stray if near[j] < 0 else 0.5 * missed[near[j]] + 0.5 * walk.apart[j] * abs(at)
        guesses.mean[j], guesses.per[j] = at, 1.0 / (0.5 + wide)
        guesses.weight[j] = walk.alike[j] if known else 0.0
        total += guesses.weight[j]
    for j in range(AROUND):
        guesses.weight[j] = guesses.weight[j] * trust[0, j] / total if total > 0.0 else 0.0
    for which in range(2):
        guesses.mean[n], guesses.weight[n] = expected, trust[0, n]
        guesses.per[n] = 1.0 / (0.3 + 0.5 * spread) if which == 0 else 1.0 / (0.5 + 1.5 * spread)
        n += 1
    there = _find_before(walk, i, k)
    if there >= 0:
        was, far, count = np.float64(walk.before.values[there]), 0.0, 0.0
        for j in (0, 2):
            if near[j] >= 0:
                far += walk.off[near[j]]
                count += 1.0
        far = far / count if count > 0.0 else _UNKNOWN
        moved = abs(walk.before.ranges[there] - ranges[i]) / ranges[i] + 0.2 * _ALIKE
        for which in range(2):
            guesses.mean[n] = was
            guesses.weight[n] = trust[0, n] * spread / (far + spread + 0.1) * min(_ALIKE / moved, 2.0)
            guesses.per[n] = 1.0 / (0.3 + 0.5 * far) if which == 0 else 1.0 / (0.5 + 1.5 * far)
            n += 1
    centre = weigh(guesses, n, expected)
    wide = bucket_by(spread, 0.25, 1.5, _SPREADS)
    half = wide // 2
    grain = 1.0 / (spread + 0.5)
    left, above, following = near[0], near[2], walk.following[i]
    scale = 100.0 / ranges[i]
    nearer = signed_bucket((ranges[left] - ranges[i]) * scale) if left >= 0 else 4
    farther = signed_bucket((ranges[following] - ranges[i]) * scale) if following >= 0 else 4
    missed_left = signed_bucket(walk.missed[left]) if left >= 0 else 4
    missed_above = signed_bucket(walk.missed[above]) if above >= 0 else 4
    of_pair = signed_bucket(off[0] * grain) * _SIGNED + signed_bucket(off[2] * grain)
    places[0] = np.int64(np.floor(min(max(centre, 0.0), _VALUES - 1.0) + 0.5))
    places[1] = _FIRST[1] + (nearer * _SIGNED + farther) * _COARSE + half
    places[2] = _FIRST[2] + of_pair * _COARSE + half
    places[3] = _FIRST[3] + (missed_left * _SIGNED + missed_above) * _COARSE + half
    for c in range(len(places)):
        places[c] *= NODES
    value = code_mixed_number(
        writing, state, data, value, centre, guesses, n, walk.models.numbers, places, wide, walk.opinions
    )
    value = min(max(value, -_LARGEST), _LARGEST)  # whatever a damaged stream says
    learn_trust(value, guesses, n, trust, 0)
    walk.missed[i] = min(max((value - centre) * grain, -100.0), 100.0)
    walk.off[i] = min(abs(value - guesses.mean[n - 1]), 1e9) if there >= 0 else _UNKNOWN
    walk.own.values[i] = value
    if walk.turn > 0:
        link(i, k, walk.own.links, walk.own.ends)
    return value


@njit(cache=True, error_model="numpy", _nrt=False)
def note_value(walk, i, value):  # type: ignore[no-untyped-def]
    """Take note of the value of point i of an organised cloud, which is known."""
    walk.own.values[i] = value
    there = _find_before(walk, i, 0)
    if there >= 0:
        walk.off[i] = min(abs(value - np.float64(walk.before.values[there])), 1e9)


class LearnedField:
    """What was learned of a field through the scans of a group; a writer tries ways, and what it learned counts once a record is :meth:`settled <settle>`."""

    def __init__(self) -> None:
        trust = np.ones((1, _MOST))
        self._models = ValueModels(new_numbers(int(_FIRST[-1]), _SPREADS, len(_CONTEXTS)), trust)
        self._before: tuple[int, Picture, int] | None = None
        self._tried: dict[int, tuple[ValueModels, Picture, int]] = {}

    def walk(
        self, what: int, around: Any, tick: I64 | None, turn: int, passed: Passed | None = None
    ) -> ValueWalk:
        """Begin a scan with copies of what is known.

        Args:
            what: neighbourhoods, as :meth:`.Points.around` takes them; the scan before tells something where it had the same.
            around: as :mod:`.blended_values` takes it; ``tick``: of the points, where lasers have told theirs; ``turn``: ticks in one.
            passed: where the points were in the scan before, if their own stream tells.
        """
        void, ranges, width, laser = around[:4]
        n = len(void)
        models = copied(self._models)
        linked = tick is not None
        at = np.zeros(0) if tick is None else tick.astype(np.float64)
        links, ends = np.full((n if linked else 0, 2), -1), np.full((_LASERS, 2), -1)
        own = Picture(at, np.zeros(n, np.int64), ranges, void, links, ends)
        before = self._before[1] if self._before is not None and self._before[0] == what else _NOTHING
        there, number = np.zeros(0, np.int64), 0
        if passed is not None:
            number = passed.number
            follows = self._before is not None and self._before[2] == number - 1
            linked, there = True, passed.there if follows else np.full(n, -1)
            # Of a damaged archive, or by other neighbourhoods.
            if there.max(initial=-1) >= len(before.values):
                there = np.full(n, -1)
        self._tried[what] = models, own, number
        return ValueWalk(
            models,
            turn,
            before if linked or width > 0 else _NOTHING,
            own,
            np.full((_LASERS, 1), -1),
            there,
            np.full(n, _UNKNOWN, np.float32),
            np.zeros(n, np.float32),
            _following(laser, void, width),
            np.zeros(AROUND),
            np.zeros(AROUND),
            new_guesses(_MOST),
            np.zeros(len(_CONTEXTS), np.int64),
            np.zeros(len(_CONTEXTS)),
        )

    def settle(self, what: int | None) -> None:
        """Keep what the walk by these neighbourhoods learned; None: nothing."""
        if what is not None:
            models, picture, number = self._tried[what]
            self._models, self._before = models, (what, picture, number)
        self._tried.clear()


_NOTHING = Picture(
    np.zeros(0),
    np.zeros(0, np.int64),
    np.zeros(0),
    np.zeros(0, np.bool_),
    np.zeros((0, 2), np.int64),
    np.full((_LASERS, 2), -1),
)
