"""One whole number by what several guesses say of it, corrected by what was seen before in its contexts.

A guess is a logistic distribution; all of them, weighted, are a mixture. A number is coded from a *centre* on: at it or not, above or
below, the size of the distance in unary, the bits below the leading one. The mixture gives every bit a probability, which is mixed
(:mod:`.mixing`) with those of contexts; bits far below the leading one are left to the mixture. Afterwards a guess is trusted more the better it did.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.entropy.mixing import EVEN, ODDS, code_given_bit, logistic, odds
from salpcc.stages.entropy.powers import above
from salpcc.stages.entropy.residual_bits import SIZES, size_of
from salpcc.stages.entropy.walks import Buffer, State
from salpcc.stages.vectors import Lanes, lane, load, size, store, totals

NODES = 64  # of a context
GIVEN = 2  # opinions beside those of contexts: the mixture's, and one that never changes
_BIAS = 0.3
_CENTRE, _SIDE, _MORE, _BELOW = range(4)  # what a bit tells
_FIRST_BELOW = 16  # node; those of the centre and the side are 0 and 1, then come sizes
_MOST_SIZES, _TOLD = 13, 2  # sizes told apart; bits below the leading one that contexts see
_LEAST, _LEAST_TOLD = 1.0 / 8192, 1.0 / 256  # chances
_GAIN = np.array(
    [int(65536 / (count + 1.6)) for count in range(128)]
)  # of a context that has seen so many bits
_RATE = 0.01  # of learning
LANES = 16
_HALF, _HARDLY = np.float32(0.5), np.float32(1e-7)
_TRUST_RATE, _LEAST_TRUST, _MOST_TRUST = 0.02, 0.01, 100.0

F64 = NDArray[np.float64]


class Numbers(NamedTuple):
    """Models: per context and node ``(…, 2)`` the chance of a 1 in 1/65536 and how many bits it has seen; weights of opinions per set and node."""

    chances: NDArray[np.uint16]
    weights: F64


class Guesses(NamedTuple):
    """Room for the guesses of one number: where each stands, 1 / its width, its weight.

    ``lanes``: of up to LANES guesses, side by side, where they stand from some number on, 1 / widths, weights, and how likely they found the number, so weighted ``(4 LANES,)``.
    """

    mean: F64
    per: F64
    weight: F64
    lanes: NDArray[np.float32]


def first_places(contexts: Sequence[int]) -> NDArray[np.int64]:
    """Return where contexts of each kind begin, one after the other, and last how many there are in all ``(kinds + 1,)``."""
    return np.concatenate([np.zeros(1, np.int64), np.cumsum(np.array(contexts, np.int64))])


def copied(models: Any) -> Any:
    """Return a named tuple of models, and of such tuples, with arrays of its own."""
    return type(models)(*(copied(part) if isinstance(part, tuple) else part.copy() for part in models))


def new_numbers(contexts: int, sets: int, opinions: int, nodes: int = NODES) -> Numbers:
    """Return fresh models of ``contexts`` contexts of ``nodes`` each, ``opinions`` of which have a say at a time, weighted by ``sets`` of weights."""
    weights = np.full((sets * NODES, GIVEN + opinions), 0.8 / opinions)
    weights[:, 0], weights[:, 1] = 0.5, 0.0
    chances = np.zeros((contexts * nodes, 2), np.uint16)
    chances[:, 0] = EVEN
    return Numbers(chances, weights.ravel())


def new_guesses(most: int) -> Guesses:
    """Return room for up to ``most`` guesses, at most LANES."""
    return Guesses(np.zeros(most), np.ones(most), np.zeros(most), np.zeros(4 * LANES, np.float32))


@njit(cache=True, error_model="numpy", _nrt=False)
def weigh(guesses: Guesses, n: int, centre: float) -> float:
    """Make weights of the first ``n`` guesses shares of 1; return where the mixture is densest: at one of them, or else at ``centre``."""
    total, densest = 1e-4, 0.0
    for j in range(n):
        total += guesses.weight[j]
    share = 1.0 / total
    for j in range(n):
        guesses.weight[j] *= share
        density = guesses.weight[j] * guesses.per[j]
        if density > densest:
            densest, centre = density, guesses.mean[j]
    return centre


@njit(cache=True, error_model="numpy", inline="always", _nrt=False)
def _lay_out(guesses: Guesses, n: int, origin: int) -> None:
    """Put the first ``n`` guesses side by side, as seen from ``origin``."""
    lanes = guesses.lanes
    for j in range(n):
        lanes[j] = np.float32(guesses.mean[j] - origin)
        lanes[LANES + j] = np.float32(guesses.per[j])
        lanes[2 * LANES + j] = np.float32(guesses.weight[j])
    for j in range(n, LANES):
        lanes[2 * LANES + j] = np.float32(0.0)


@njit(cache=True, error_model="numpy", inline="always", _nrt=False)
def _beyond(lanes: NDArray[np.float32], side: float, distance: float) -> Lanes:
    """Of each guess, what is farther than a distance from the origin on one side (1 or -1)."""
    off = np.float32(distance) - np.float32(side) * load(lanes, 0, LANES)
    return load(lanes, 2 * LANES, LANES) * above(off * load(lanes, LANES, LANES))


@njit(cache=True, error_model="numpy", inline="always", _nrt=False)
def _farther(lanes: NDArray[np.float32], side: float, distance: float) -> float:
    """Of the mixture, what is at least a whole distance from the origin on one side."""
    return np.float64(lane(totals(_beyond(lanes, side, distance - 0.5)), 0))


@njit(cache=True, error_model="numpy", inline="always", _nrt=False)
def code_told_bit(
    writing: bool,
    state: State,
    buffer: Buffer,
    bit: int,
    opinion: float,
    node: int,
    numbers: Numbers,
    places: NDArray[np.int64],
    of_set: int,
    opinions: F64,
) -> int:
    """Code one bit by an opinion (logarithm of the odds of a 1) and those of ``node`` of the contexts ``places``, and learn from it."""
    chances, weights = numbers
    n = len(places)
    first = (of_set * NODES + node) * (GIVEN + n)
    total = opinion * weights[first] + _BIAS * weights[first + 1]
    for c in range(n):
        opinions[c] = ODDS[chances[places[c] + node, 0] >> 4]
        total += opinions[c] * weights[first + GIVEN + c]
    p = min(max(logistic(total), _LEAST), 1.0 - _LEAST)
    bit = code_given_bit(writing, state, buffer, p, bit)
    step = (bit - p) * _RATE
    weights[first] += step * opinion
    weights[first + 1] += step * _BIAS
    goal = 65535 if bit == 1 else 0
    for c in range(n):
        weights[first + GIVEN + c] += step * opinions[c]
        at = places[c] + node
        chance, count = np.int64(chances[at, 0]), np.int64(chances[at, 1])
        chances[at, 0] = chance + (((goal - chance) * _GAIN[count]) >> 16)
        if count < len(_GAIN) - 1:
            chances[at, 1] = count + 1
    return bit


@njit(cache=True, error_model="numpy", inline="always", _nrt=False)
def code_mixed_number(
    writing: bool,
    state: State,
    buffer: Buffer,
    value: int,
    centre: float,
    guesses: Guesses,
    n: int,
    numbers: Numbers,
    places: NDArray[np.int64],
    of_set: int,
    opinions: F64,
) -> int:
    """Write ``value``, less than ``2 ** (SIZES - 1)`` from the centre, or read and return it.

    Args:
        guesses: the first ``n`` of them, weights shares of 1.
        places: the contexts, times NODES; ``of_set`` chooses the weights; ``opinions``: room for one of each place.
    """
    middle = np.int64(np.floor(centre + 0.5))
    distance = abs(value - middle)
    wanted = size_of(distance) - 1
    lanes = guesses.lanes
    _lay_out(guesses, n, middle)
    both = totals(_beyond(lanes, -1.0, 0.5), _beyond(lanes, 1.0, 0.5))
    low, high = np.float64(lane(both, 0)), np.float64(lane(both, 1))
    # Of the mixture, what is as far away as the bit before says, or farther; and what is farther still, and beyond the bit that is asked for.
    inner, outer, beyond = 0.0, 0.0, 0.0
    asked, node, share = _CENTRE, 0, low + high
    side, size, shift, found = 1.0, 0, 0, np.int64(0)
    while True:
        if asked == _CENTRE:
            bit = np.int64(distance != 0)
        elif asked == _SIDE:
            bit = np.int64(value < middle)
        elif asked == _MORE:
            bit = np.int64(size < wanted)
        else:
            bit = (distance >> shift) & 1
        if node >= 0:
            bit = code_told_bit(
                writing, state, buffer, bit, odds(share), node, numbers, places, of_set, opinions
            )
        else:
            bit = code_given_bit(writing, state, buffer, min(max(share, _LEAST_TOLD), 1.0 - _LEAST_TOLD), bit)
        if asked == _CENTRE:
            if bit == 0:
                return int(middle)
            asked, node, share = _SIDE, 1, (low + 1e-5) / (low + high + 2e-5)
            continue
        if asked == _SIDE:
            side = -1.0 if bit == 1 else 1.0
            inner = low if bit == 1 else high
            asked = _MORE
        elif asked == _MORE:
            if bit == 1:
                inner = outer
                size += 1
            if bit == 0 or size == SIZES - 2:
                asked, shift, found = _BELOW, size, np.int64(1) << size
        elif bit == 1:
            found, inner = found + (np.int64(1) << shift), beyond
        else:
            outer = beyond
        if asked == _MORE:
            outer = _farther(lanes, side, np.float64(2 << size))
            node, share = 2 + min(size, _MOST_SIZES), (outer + 1e-6) / (inner + 2e-6)
            continue
        shift -= 1
        if shift < 0:
            return int(middle - found if side < 0.0 else middle + found)
        beyond = _farther(lanes, side, np.float64(found + (np.int64(1) << shift)))
        share = (beyond - outer + 1e-7) / (inner - outer + 2e-7)
        known = size - 1 - shift
        node = -1
        if known < _TOLD:
            node = _FIRST_BELOW + 3 * min(size, 15)
            node += 0 if known == 0 else 1 + int((found >> (shift + 1)) & 1)


@njit(cache=True, error_model="numpy", _nrt=False)
def learn_trust(value: int, guesses: Guesses, n: int, trust: F64, which: int) -> None:
    """Move the trust ``trust[which]`` in each of the ``n`` guesses towards its share in how likely ``value`` was."""
    lanes = guesses.lanes
    _lay_out(guesses, n, value)
    off, per = size(load(lanes, 0, LANES)), load(lanes, LANES, LANES)
    likely = above((off - _HALF) * per) - above((off + _HALF) * per) + _HARDLY
    likely = load(lanes, 2 * LANES, LANES) * likely
    store(lanes, 3 * LANES, likely)
    per_likely = 1.0 / np.float64(lane(totals(likely), 0))
    for j in range(n):
        if guesses.weight[j] == 0.0:  # who says nothing is trusted as before
            continue
        moved = lanes[3 * LANES + j] * per_likely - guesses.weight[j]
        moved = trust[which, j] * (1.0 + _TRUST_RATE * moved)
        trust[which, j] = min(max(moved, _LEAST_TRUST), _MOST_TRUST)
