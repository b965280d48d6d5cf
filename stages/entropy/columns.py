"""Columns of numbers of any kind, losslessly: the fields of points that no model of ours knows.

Every value is predicted from those before it: its left neighbour, the one ``period`` before (the row above,
or the same laser one firing earlier), or both. Points without a return (*void*) are predicted from void ones
only. Residuals are modulo ``2 ** width``, so any bits go through.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.entropy.range_coder import (
    decode_interval,
    decode_mixed_bit,
    decode_target,
    encode_interval,
    encode_mixed_bit,
    finish_encoder,
    new_bits,
    start_decoder,
    start_encoder,
)

LEFT, ABOVE, SLOPE, LINE, MEAN, EDGE = range(6)
PREDICTORS = 6
_SIZES = 65  # magnitudes of 0 to 64 bits
_NODES = 2 + 4 * _SIZES  # zero, sign, and per size: go on, two leading bits
_SLOPES, _SIZES_TOLD = 21, 12  # sizes told apart in the two families of contexts

Values = NDArray[np.int64]
Flags = NDArray[np.bool_]


def _residual_models() -> tuple[NDArray[np.uint16], NDArray[np.uint16]]:
    return new_bits(_SLOPES * 2 * _NODES), new_bits(_SIZES_TOLD**2 * 2 * _NODES)


@njit(cache=True)
def _wrap(value: int, width: int) -> int:
    return (value << (64 - width)) >> (64 - width)


@njit(cache=True)
def _size(magnitude: int) -> int:
    size = 0
    while magnitude != 0:
        size += 1
        magnitude = (magnitude >> 1) & 0x7FFFFFFFFFFFFFFF
    return size


@njit(cache=True)
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
    return left, second, above, corner


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
def costs(values: Values, void: Flags, period: int, width: int) -> NDArray[np.int64]:
    """Rough bits that the residuals of each predictor would take, ``(PREDICTORS,)``."""
    total = np.zeros(PREDICTORS, np.int64)
    last = np.full((2, 2), -1, np.int64)
    for i in range(len(values)):
        left, second, above, corner = neighbours(values, void, i, period, last)
        for p in range(PREDICTORS):
            residual = _wrap(values[i] - _predict(p, left, second, above, corner), width)
            size = _size(abs(residual))
            total[p] += size + (2 if size > 0 else 0)
        kind = 1 if void[i] else 0
        last[kind, 1] = last[kind, 0]
        last[kind, 0] = i
    return total


@njit(cache=True)
def _contexts(
    sizes: NDArray[np.int64], void: Flags, i: int, period: int, last: NDArray[np.int64], slope: int
) -> tuple[int, int]:
    kind = 1 if void[i] else 0
    near = sizes[last[kind, 0]] if last[kind, 0] >= 0 else 0
    far = sizes[i - period] if i >= period else near
    first = min(slope, 20) * 2 + kind
    second = (min(near, 11) * 12 + min(far, 11)) * 2 + kind
    return first * 262, second * 262


@njit(cache=True)
def _encode_residuals(
    values: Values,
    void: Flags,
    period: int,
    predictor: int,
    width: int,
    a: NDArray[np.uint16],
    b: NDArray[np.uint16],
    out: NDArray[np.uint8],
) -> int:
    state = start_encoder()
    sizes = np.zeros(len(values), np.int64)
    last = np.full((2, 2), -1, np.int64)
    for i in range(len(values)):
        left, second, above, corner = neighbours(values, void, i, period, last)
        residual = _wrap(values[i] - _predict(predictor, left, second, above, corner), width)
        f, g = _contexts(sizes, void, i, period, last, _size(abs(left - above) + abs(above - corner)))
        magnitude = abs(residual)
        size = _size(magnitude)
        encode_mixed_bit(state, out, a, f, b, g, 1 if size > 0 else 0)
        if size > 0:
            encode_mixed_bit(state, out, a, f + 1, b, g + 1, 1 if residual < 0 else 0)
            for s in range(1, size):
                encode_mixed_bit(state, out, a, f + 2 + 4 * s, b, g + 2 + 4 * s, 1)
            if size < width:
                encode_mixed_bit(state, out, a, f + 2 + 4 * size, b, g + 2 + 4 * size, 0)
            node = 1
            bits = size - 1
            while bits > 0 and node < 4:
                bits -= 1
                bit = (magnitude >> bits) & 1
                at = 2 + 4 * size + node
                encode_mixed_bit(state, out, a, f + at, b, g + at, bit)
                node = 2 + bit if node == 1 else 4
            while bits > 0:
                chunk = min(bits, 24)
                bits -= chunk
                encode_interval(state, out, (magnitude >> bits) & ((1 << chunk) - 1), 1, chunk)
        sizes[i] = size
        kind = 1 if void[i] else 0
        last[kind, 1] = last[kind, 0]
        last[kind, 0] = i
    return finish_encoder(state, out)


@njit(cache=True)
def _decode_residuals(
    void: Flags,
    period: int,
    predictor: int,
    width: int,
    a: NDArray[np.uint16],
    b: NDArray[np.uint16],
    data: NDArray[np.uint8],
) -> tuple[Values, bool]:
    values = np.zeros(len(void), np.int64)
    sizes = np.zeros(len(void), np.int64)
    state = start_decoder(data)
    last = np.full((2, 2), -1, np.int64)
    for i in range(len(void)):
        left, second, above, corner = neighbours(values, void, i, period, last)
        f, g = _contexts(sizes, void, i, period, last, _size(abs(left - above) + abs(above - corner)))
        size = 0
        magnitude = np.int64(0)
        negative = False
        if decode_mixed_bit(state, data, a, f, b, g) == 1:
            negative = decode_mixed_bit(state, data, a, f + 1, b, g + 1) == 1
            size = 1
            while (
                size < width and decode_mixed_bit(state, data, a, f + 2 + 4 * size, b, g + 2 + 4 * size) == 1
            ):
                size += 1
            magnitude = np.int64(1)
            node = 1
            bits = size - 1
            while bits > 0 and node < 4:
                bits -= 1
                at = 2 + 4 * size + node
                bit = decode_mixed_bit(state, data, a, f + at, b, g + at)
                magnitude = (magnitude << 1) | bit
                node = 2 + bit if node == 1 else 4
            while bits > 0:
                chunk = min(bits, 24)
                bits -= chunk
                target = decode_target(state, chunk)
                decode_interval(state, data, target, 1, chunk)
                magnitude = (magnitude << chunk) | target
        if state[3] != 0:
            return values, False
        residual = -magnitude if negative else magnitude
        values[i] = _wrap(_predict(predictor, left, second, above, corner) + residual, width)
        sizes[i] = size
        kind = 1 if void[i] else 0
        last[kind, 1] = last[kind, 0]
        last[kind, 0] = i
    return values, True


def encode_residuals(values: Values, void: Flags, period: int, predictor: int, width: int) -> bytes:
    """Encode values ``(N,)``, signed numbers of ``width`` bits."""
    size = 4 * len(values) + 4096
    while True:
        out = np.empty(size, np.uint8)
        written = int(_encode_residuals(values, void, period, predictor, width, *_residual_models(), out))
        if written >= 0:
            return out[:written].tobytes()
        size *= 4


def decode_residuals(
    void: Flags, period: int, predictor: int, width: int, data: bytes
) -> tuple[Values, bool]:
    """Inverse of :func:`encode_residuals`: the values, and whether the data made sense."""
    raw = np.frombuffer(bytearray(data), np.uint8)
    values, sound = _decode_residuals(void, period, predictor, width, *_residual_models(), raw)
    return values, bool(sound)
