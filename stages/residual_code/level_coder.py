"""Range levels against their prediction: adaptive bits in the context of the expected error.

Each bit is coded by the mean of two contexts: the expected error alone, and a coarser expected error
with the sign and size of the residual before it in the ring. A residual is coded as zero or not, sign, magnitude class (1, 2-3, 4-7, ...) in unary, and the bits
below the leading one, most significant first; the first two of those adapt, the others are even.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.predict.neighbours import (
    N_PREDICTORS,
    N_SPREADS,
    PRIOR_ERROR,
    learn_return,
    new_state,
    predict_return,
    spread_bucket,
)
from salpcc.stages.residual_code.range_coder import (
    decode_interval,
    decode_mixed_bit,
    decode_target,
    encode_interval,
    encode_mixed_bit,
    finish_encoder,
    start_decoder,
    start_encoder,
)

_CLASSES = 22  # magnitudes below 2 ** 21
_PER_SPREAD = 2 + _CLASSES * 4
CONTEXTS = N_SPREADS * _PER_SPREAD
_SIZES_BEFORE = 8
CONTEXTS_BEFORE = 3 * _SIZES_BEFORE * (N_SPREADS // 2) * _PER_SPREAD


@njit(cache=True, error_model="numpy")
def _size(magnitude: int) -> int:
    """Number of bits of a magnitude."""
    size = 0
    while (magnitude >> size) != 0:
        size += 1
    return size


@njit(cache=True, error_model="numpy")
def _base_before(bucket: int, before: int) -> int:
    """Second context of a residual: the half bucket, and the sign and size of the residual before it."""
    sign = 1 if before > 0 else (2 if before < 0 else 0)
    place = min(_size(abs(before)), _SIZES_BEFORE - 1) * 3 + sign
    return (place * (N_SPREADS // 2) + bucket // 2) * _PER_SPREAD


@njit(cache=True, error_model="numpy")
def _encode_residual(state, out, model, recent, bucket, before, residual):  # type: ignore[no-untyped-def]
    a = bucket * _PER_SPREAD
    b = _base_before(bucket, before)
    encode_mixed_bit(state, out, model, a, recent, b, 1 if residual != 0 else 0)
    if residual == 0:
        return
    encode_mixed_bit(state, out, model, a + 1, recent, b + 1, 1 if residual < 0 else 0)
    magnitude = abs(residual)
    size = _size(magnitude) - 1
    for c in range(size):
        encode_mixed_bit(state, out, model, a + 2 + c * 4, recent, b + 2 + c * 4, 1)
    at = 2 + size * 4
    if size < _CLASSES - 1:
        encode_mixed_bit(state, out, model, a + at, recent, b + at, 0)
    if size >= 1:
        first = (magnitude >> (size - 1)) & 1
        encode_mixed_bit(state, out, model, a + at + 1, recent, b + at + 1, first)
        if size >= 2:
            second = (magnitude >> (size - 2)) & 1
            encode_mixed_bit(state, out, model, a + at + 2 + first, recent, b + at + 2 + first, second)
            if size > 2:
                bits = size - 2
                encode_interval(state, out, magnitude & ((1 << bits) - 1), 1, bits)


@njit(cache=True, error_model="numpy")
def _decode_residual(state, data, model, recent, bucket, before):  # type: ignore[no-untyped-def]
    a = bucket * _PER_SPREAD
    b = _base_before(bucket, before)
    if decode_mixed_bit(state, data, model, a, recent, b) == 0:
        return 0
    negative = decode_mixed_bit(state, data, model, a + 1, recent, b + 1)
    size = 0
    while size < _CLASSES - 1 and decode_mixed_bit(
        state, data, model, a + 2 + size * 4, recent, b + 2 + size * 4
    ):
        size += 1
    at = 2 + size * 4
    magnitude = 1
    if size >= 1:
        first = decode_mixed_bit(state, data, model, a + at + 1, recent, b + at + 1)
        magnitude = 2 | first
        if size >= 2:
            second = decode_mixed_bit(state, data, model, a + at + 2 + first, recent, b + at + 2 + first)
            magnitude = (magnitude << 1) | second
            if size > 2:
                bits = size - 2
                rest = decode_target(state, bits)
                decode_interval(state, data, rest, 1, bits)
                magnitude = (magnitude << bits) | rest
    return -magnitude if negative else magnitude


@njit(cache=True, error_model="numpy")
def encode_levels(
    starts: NDArray[np.int64],
    level: NDArray[np.int32],
    prediction: NDArray[np.int32],
    spread: NDArray[np.uint8],
    model: NDArray[np.uint16],
    recent: NDArray[np.uint16],
    out: NDArray[np.uint8],
) -> int:
    """Encode levels ``(M,)`` given their predictions; return the bytes written to ``out``, -1 if full."""
    state = start_encoder()
    for k in range(len(starts) - 1):
        before = 0
        for i in range(starts[k], starts[k + 1]):
            residual = np.int64(level[i]) - np.int64(prediction[i])
            _encode_residual(state, out, model, recent, np.int64(spread[i]), before, residual)
            before = residual
    return finish_encoder(state, out)


@njit(cache=True, error_model="numpy")
def decode_levels(
    starts: NDArray[np.int64],
    tick: NDArray[np.int32],
    step: int,
    table: NDArray[np.float64],
    model: NDArray[np.uint16],
    recent: NDArray[np.uint16],
    data: NDArray[np.uint8],
) -> tuple[NDArray[np.int32], bool]:
    """Decode what :func:`encode_levels` wrote with the predictions of ``predict_levels``.

    Returns:
        levels int32 ``(M,)`` and whether the data sufficed.
    """
    n = len(tick)
    level = np.empty(n, np.int32)
    state = start_decoder(data)
    inverse, azimuths, errors = new_state(n)
    guesses = np.zeros(N_PREDICTORS)
    above = 0
    middle = (step - 1) / 2.0
    for k in range(len(starts) - 1):
        begin = starts[k]
        running = np.full(N_PREDICTORS, PRIOR_ERROR)
        cursor = above - 1
        before = 0
        for i in range(begin, starts[k + 1]):
            mean, spread, cursor = predict_return(
                i, begin, above, cursor, tick[i], table[k, 2], table[k, 1],
                inverse, azimuths, errors, running, guesses,
            )  # fmt: skip
            predicted = np.int64(np.floor((mean - table[k, 0] - middle) / step + 0.5))
            bucket = spread_bucket(spread / step)
            before = _decode_residual(state, data, model, recent, bucket, before)
            level[i] = min(max(predicted + before, 0), (1 << 20) - 1)
            learn_return(
                i, level[i] * step + middle + table[k, 0], tick[i], table[k, 2], table[k, 1],
                inverse, azimuths, errors, running, guesses,
            )  # fmt: skip
        if starts[k + 1] > begin:
            above = begin
    return level, state[3] == 0
