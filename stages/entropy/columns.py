"""Columns of numbers of any kind, losslessly: the fields of points that no model of ours knows.

Every value is predicted from those before it: its left neighbour, the one ``period`` before (the row above,
or the same laser one firing earlier), or both. Points without a return (*void*) are predicted from void ones
only. Residuals are modulo ``2 ** width``, so any bits go through.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.entropy.buffer import as_array, run_encoder
from salpcc.stages.entropy.range_coder import new_bits
from salpcc.stages.entropy.residual_bits import size_of
from salpcc.stages.entropy.walks import code_mixed_bit, code_raw, failed, finish_coder, start_coder, uncounted

LEFT, ABOVE, SLOPE, LINE, MEAN, EDGE = range(6)
PREDICTORS = 6
_SIZES = 65  # magnitudes of 0 to 64 bits
_NODES = 2 + 4 * _SIZES  # zero, sign, and per size: go on, two leading bits
_CHECKED = 256  # values after which costs are looked at
_SLOPES, _SIZES_TOLD = 21, 12  # sizes told apart in the two families of contexts

Values = NDArray[np.int64]
Flags = NDArray[np.bool_]


def _residual_models() -> tuple[NDArray[np.uint16], NDArray[np.uint16]]:
    return new_bits(_SLOPES * 2 * _NODES), new_bits(_SIZES_TOLD**2 * 2 * _NODES)


@njit(cache=True)
def _wrap(value: int, width: int) -> int:
    return (value << (64 - width)) >> (64 - width)


def nothing_yet() -> NDArray[np.int64]:
    """Places ``(2, 2)`` of the last two values of either kind, before the first."""
    return np.full((2, 2), -1, np.int64)


@njit(cache=True, forceinline=True)
def neighbours(
    values: Values, void: Flags, i: int, period: int, last: NDArray[np.int64]
) -> tuple[int, int, int, int]:
    """Values to the left, left of that, above, and above left; neighbours of the other kind do not count."""
    kind = 1 if void[i] else 0
    left = values[last[kind, 0]] if last[kind, 0] >= 0 else np.int64(0)
    second = values[last[kind, 1]] if last[kind, 1] >= 0 else left
    above = left
    corner = left
    if i >= period and void[i - period] == void[i]:
        above = values[i - period]
        corner = above
        if i > period and void[i - period - 1] == void[i]:
            corner = values[i - period - 1]
    return int(left), int(second), int(above), int(corner)


@njit(cache=True)
def _predict(predictor: int, left: int, second: int, above: int, corner: int) -> int:
    if predictor == 1:
        return above
    if predictor == 2:
        return left + above - corner
    if predictor == 3:
        return left + left - second
    if predictor == 4:
        return left + ((above - left) >> 1)
    if predictor == 5:
        # The plane through the neighbours, but never beyond them (LOCO-I).
        low, high = min(left, above), max(left, above)
        return min(max(left + above - corner, low), high)
    return left


@njit(cache=True)
def costs(values: Values, void: Flags, period: int, width: int, to_beat: int) -> NDArray[np.int64]:
    """Rough bits that the residuals of each predictor would take, ``(PREDICTORS,)``; of fewer values where all are above ``to_beat``."""
    total = np.zeros(PREDICTORS, np.int64)
    last = np.full((2, 2), -1, np.int64)
    for i in range(len(values)):
        if i % _CHECKED == 0 and total.min() > to_beat:
            break
        left, second, above, corner = neighbours(values, void, i, period, last)
        for p in range(PREDICTORS):
            residual = _wrap(values[i] - _predict(p, left, second, above, corner), width)
            size = size_of(abs(residual))
            total[p] += size + (2 if size > 0 else 0)
        kind = 1 if void[i] else 0
        last[kind, 1] = last[kind, 0]
        last[kind, 0] = i
    return total


@njit(cache=True, forceinline=True)
def _contexts(
    sizes: NDArray[np.int64], void: Flags, i: int, period: int, last: NDArray[np.int64], slope: int
) -> tuple[int, int]:
    kind = 1 if void[i] else 0
    near = sizes[last[kind, 0]] if last[kind, 0] >= 0 else 0
    far = sizes[i - period] if i >= period else near
    first = min(slope, 20) * 2 + kind
    second = (min(near, 11) * 12 + min(far, 11)) * 2 + kind
    return first * 262, second * 262


@njit(cache=True, forceinline=True, _nrt=False)
def _code_residual(
    writing: bool,
    residual: int,
    width: int,
    state: NDArray[np.int64],
    a: NDArray[np.uint16],
    f: int,
    b: NDArray[np.uint16],
    g: int,
    buffer: NDArray[np.uint8],
) -> tuple[int, int]:
    """Code zero or not, sign, size in unary, two leading bits, the rest as it is; returns residual and size."""
    magnitude = abs(residual)
    size = size_of(magnitude)
    if code_mixed_bit(writing, state, buffer, a, f, b, g, 1 if size > 0 else 0) == 0:
        return 0, 0
    negative = code_mixed_bit(writing, state, buffer, a, f + 1, b, g + 1, 1 if residual < 0 else 0)
    s = 1
    while s < width:
        at = 2 + 4 * s
        if code_mixed_bit(writing, state, buffer, a, f + at, b, g + at, 1 if s < size else 0) == 0:
            break
        s += 1
    size = s
    value = np.int64(1)
    node = 1
    bits = size - 1
    while bits > 0 and node < 4:
        bits -= 1
        at = 2 + 4 * size + node
        bit = code_mixed_bit(writing, state, buffer, a, f + at, b, g + at, (magnitude >> bits) & 1)
        value = (value << 1) | bit
        node = 2 + bit if node == 1 else 4
    while bits > 0:
        chunk = min(bits, 24)
        bits -= chunk
        value = (value << chunk) | code_raw(writing, state, buffer, chunk, magnitude >> bits)
    return int(-value if negative == 1 else value), size


@uncounted
def _walk(
    writing: bool,
    state: NDArray[np.int64],
    sizes: NDArray[np.int64],
    last: NDArray[np.int64],
    values: Values,
    void: Flags,
    period: int,
    predictor: int,
    width: int,
    a: NDArray[np.uint16],
    b: NDArray[np.uint16],
    buffer: NDArray[np.uint8],
) -> int:
    for i in range(len(values)):
        left, second, above, corner = neighbours(values, void, i, period, last)
        predicted = _predict(predictor, left, second, above, corner)
        f, g = _contexts(sizes, void, i, period, last, size_of(abs(left - above) + abs(above - corner)))
        residual = _wrap(values[i] - predicted, width)
        residual, sizes[i] = _code_residual(writing, residual, width, state, a, f, b, g, buffer)
        if failed(state):
            break
        values[i] = _wrap(predicted + residual, width)
        kind = 1 if void[i] else 0
        last[kind, 1] = last[kind, 0]
        last[kind, 0] = i
    return finish_coder(writing, state, buffer)


def encode_residuals(values: Values, void: Flags, period: int, predictor: int, width: int) -> bytes:
    """Encode values ``(N,)``, signed numbers of ``width`` bits."""

    def walk(out: NDArray[np.uint8]) -> int:
        state, sizes, models = start_coder(True, out), np.zeros(len(values), np.int64), _residual_models()
        coded = values.copy()
        return int(
            _walk(True, state, sizes, nothing_yet(), coded, void, period, predictor, width, *models, out)
        )

    return run_encoder(walk, len(values))


def decode_residuals(
    void: Flags, period: int, predictor: int, width: int, data: bytes
) -> tuple[Values, bool]:
    """Inverse of :func:`encode_residuals`: the values, and whether the data made sense."""
    raw = as_array(data)
    values = np.zeros(len(void), np.int64)
    state, sizes, models = start_coder(False, raw), np.zeros(len(void), np.int64), _residual_models()
    done = _walk(False, state, sizes, nothing_yet(), values, void, period, predictor, width, *models, raw)
    return values, done == 0
