"""Range levels against their prediction: adaptive bits in the context of the expected error.

A residual is coded as zero or not, sign, magnitude class (1, 2-3, 4-7, ...) in unary, and the bits
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
    decode_bit,
    decode_interval,
    decode_target,
    encode_bit,
    encode_interval,
    finish_encoder,
    start_decoder,
    start_encoder,
)

_CLASSES = 22  # magnitudes below 2 ** 21
_PER_SPREAD = 2 + _CLASSES * 4
CONTEXTS = N_SPREADS * _PER_SPREAD


@njit(cache=True, error_model="numpy")
def _encode_residual(state, out, model, bucket, residual):  # type: ignore[no-untyped-def]
    base = bucket * _PER_SPREAD
    encode_bit(state, out, model, base, 1 if residual != 0 else 0)
    if residual == 0:
        return
    encode_bit(state, out, model, base + 1, 1 if residual < 0 else 0)
    magnitude = abs(residual)
    size = 0
    while (magnitude >> (size + 1)) != 0:
        size += 1
    for c in range(size):
        encode_bit(state, out, model, base + 2 + c * 4, 1)
    if size < _CLASSES - 1:
        encode_bit(state, out, model, base + 2 + size * 4, 0)
    if size >= 1:
        first = (magnitude >> (size - 1)) & 1
        encode_bit(state, out, model, base + 2 + size * 4 + 1, first)
        if size >= 2:
            encode_bit(state, out, model, base + 2 + size * 4 + 2 + first, (magnitude >> (size - 2)) & 1)
            if size > 2:
                bits = size - 2
                encode_interval(state, out, magnitude & ((1 << bits) - 1), 1, bits)


@njit(cache=True, error_model="numpy")
def _decode_residual(state, data, model, bucket):  # type: ignore[no-untyped-def]
    base = bucket * _PER_SPREAD
    if decode_bit(state, data, model, base) == 0:
        return 0
    negative = decode_bit(state, data, model, base + 1)
    size = 0
    while size < _CLASSES - 1 and decode_bit(state, data, model, base + 2 + size * 4) == 1:
        size += 1
    magnitude = 1
    if size >= 1:
        first = decode_bit(state, data, model, base + 2 + size * 4 + 1)
        magnitude = 2 | first
        if size >= 2:
            second = decode_bit(state, data, model, base + 2 + size * 4 + 2 + first)
            magnitude = (magnitude << 1) | second
            if size > 2:
                bits = size - 2
                rest = decode_target(state, bits)
                decode_interval(state, data, rest, 1, bits)
                magnitude = (magnitude << bits) | rest
    return -magnitude if negative else magnitude


@njit(cache=True, error_model="numpy")
def encode_levels(
    level: NDArray[np.int32],
    prediction: NDArray[np.int32],
    spread: NDArray[np.uint8],
    model: NDArray[np.uint16],
    out: NDArray[np.uint8],
) -> int:
    """Encode levels ``(M,)`` given their predictions; return the bytes written to ``out``, -1 if full."""
    state = start_encoder()
    for i in range(len(level)):
        _encode_residual(state, out, model, np.int64(spread[i]), np.int64(level[i]) - np.int64(prediction[i]))
    return finish_encoder(state, out)


@njit(cache=True, error_model="numpy")
def decode_levels(
    starts: NDArray[np.int64],
    tick: NDArray[np.int32],
    step: int,
    table: NDArray[np.float64],
    model: NDArray[np.uint16],
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
        for i in range(begin, starts[k + 1]):
            mean, spread, cursor = predict_return(
                i, begin, above, cursor, tick[i], table[k, 2], table[k, 1],
                inverse, azimuths, errors, running, guesses,
            )  # fmt: skip
            predicted = np.int64(np.floor((mean - table[k, 0] - middle) / step + 0.5))
            value = predicted + _decode_residual(state, data, model, spread_bucket(spread / step))
            level[i] = min(max(value, 0), (1 << 20) - 1)
            learn_return(
                i, level[i] * step + middle + table[k, 0], tick[i], table[k, 2], table[k, 1],
                inverse, azimuths, errors, running, guesses,
            )  # fmt: skip
        if starts[k + 1] > begin:
            above = begin
    return level, state[3] == 0
