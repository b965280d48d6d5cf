"""Logistic mixing: several opinions on a bit become one probability, and learn from what the bit was.

An opinion is the logarithm of the odds of a 1. Some are given, the others are those of contexts, each an estimate
that follows the bits seen in it. All is float64 by ``+ - * /`` in a fixed order, with tables for the logistic
function and its inverse, so that encoder and decoder agree on every machine. Steps are for both directions, as those of
:mod:`~salpcc.stages.entropy.walks` are.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.entropy.range_coder import decode_interval, encode_interval
from salpcc.stages.entropy.walks import Buffer, State

_REACH = 12.0
_PER_UNIT = 64
_STEPS = 4096
_BITS = 16  # of a probability
_LEAST = 1.0 / 8192
_SLOWEST = 90  # an estimate is a mean over about so many bits
_HEAD_START = 1.6
EVEN = 1 << 15


def _exp(x: float) -> float:
    """e to the x by its series, after halving."""
    halvings = 0
    while abs(x) > 0.5:
        x /= 2.0
        halvings += 1
    term = total = 1.0
    for n in range(1, 20):
        term = term * x / n
        total += term
    for _ in range(halvings):
        total *= total
    return total


def _ln(x: float) -> float:
    """Natural logarithm by the series of the area tangent, after halving or doubling."""
    doublings = 0
    while x > 1.5:
        x /= 2.0
        doublings += 1
    while x < 0.75:
        x *= 2.0
        doublings -= 1
    u = (x - 1.0) / (x + 1.0)
    term, total = u, 0.0
    for n in range(1, 40, 2):
        total += term / n
        term = term * u * u
    return 2.0 * total + doublings * 0.6931471805599453


_LOGISTIC = np.array(
    [1.0 / (1.0 + _exp(_REACH - k / _PER_UNIT)) for k in range(int(2 * _REACH * _PER_UNIT) + 2)]
)
ODDS = np.array([_ln((k + 0.5) / (_STEPS - k - 0.5)) for k in range(_STEPS)])


@njit(cache=True, error_model="numpy", _nrt=False)
def logistic(x: float) -> float:
    """Logistic function, interpolated in its table; flat beyond 12."""
    z = (min(max(x, -_REACH), _REACH) + _REACH) * _PER_UNIT
    k = np.uint64(z)  # no index from the end
    low = _LOGISTIC[k]
    return low + (z - k) * (_LOGISTIC[k + np.uint64(1)] - low)


@njit(cache=True, error_model="numpy", _nrt=False)
def odds(p: float) -> float:
    """Logarithm of the odds of a probability, in 4096 steps; inverse of :func:`logistic`."""
    return ODDS[min(max(int(p * _STEPS), 0), _STEPS - 1)]


@njit(cache=True, error_model="numpy", _nrt=False)
def code_given_bit(writing: bool, state: State, buffer: Buffer, p: float, bit: int) -> int:
    """Code one bit whose probability of being 1 is given."""
    zero = (1 << _BITS) - min(max(int(p * (1 << _BITS)), 8), (1 << _BITS) - 8)
    if not writing:
        bit = (
            1 if state[0] >= (state[1] >> _BITS) * zero else 0
        )  # as decode_target would tell, without a division
    low, width = (zero, (1 << _BITS) - zero) if bit == 1 else (0, zero)
    if writing:
        encode_interval(state, buffer, low, width, _BITS)
    else:
        decode_interval(state, buffer, low, width, _BITS)
    return bit


@njit(cache=True, error_model="numpy", _nrt=False)
def code_learned_bit(
    writing: bool,
    state: State,
    buffer: Buffer,
    bit: int,
    opinions: NDArray[np.float64],
    given: int,
    places: NDArray[np.int64],
    chances: NDArray[np.uint16],
    counts: NDArray[np.uint8],
    weights: NDArray[np.float64],
    rate: float,
) -> int:
    """Code one bit by ``given`` opinions and those of the contexts ``places``, and learn from it.

    Args:
        opinions: room for all; the first ``given`` are set.
        chances, counts: per context the probability of a 1 in 1/65536, and how many bits it has seen.
        weights: of the opinions; they change.
    """
    n = given + len(places)
    total = 0.0
    for i in range(n):
        if i >= given:
            opinions[i] = ODDS[chances[places[i - given]] >> 4]
        total += opinions[i] * weights[i]
    p = min(max(logistic(total), _LEAST), 1.0 - _LEAST)
    bit = code_given_bit(writing, state, buffer, p, bit)
    step = (bit - p) * rate
    for i in range(n):
        weights[i] += step * opinions[i]
    goal = 65535 if bit == 1 else 0
    for place in places:
        chance, count = np.int64(chances[place]), np.int64(counts[place])
        chances[place] = chance + int((goal - chance) / (count + _HEAD_START))
        if count < _SLOWEST:
            counts[place] = count + 1
    return bit
