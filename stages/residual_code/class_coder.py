"""Class of each return: adaptive bits in the context of the classes to the left and above."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.entropy.range_coder import (
    decode_bit,
    encode_bit,
    finish_encoder,
    start_decoder,
    start_encoder,
)

BITS = 5  # 32 classes at most
_TREE = 1 << BITS
CONTEXTS = _TREE * _TREE * _TREE


@njit(cache=True)
def encode_classes(
    starts: NDArray[np.int64],
    tick: NDArray[np.int32],
    value: NDArray[np.uint8],
    model: NDArray[np.uint16],
    out: NDArray[np.uint8],
) -> int:
    """Encode classes below 32 ``(M,)``; return the bytes written to ``out``, -1 if full."""
    state = start_encoder()
    above = 0
    for k in range(len(starts) - 1):
        begin = starts[k]
        j = above
        left = 0
        for i in range(begin, starts[k + 1]):
            while j + 1 < begin and tick[j] < tick[i]:
                j += 1
            up = np.int64(value[j]) if j < begin else 0
            node = 1
            for b in range(BITS - 1, -1, -1):
                bit = (np.int64(value[i]) >> b) & 1
                encode_bit(state, out, model, (left * _TREE + up) * _TREE + node, bit)
                node = node << 1 | bit
            left = np.int64(value[i])
        if starts[k + 1] > begin:
            above = begin
    return finish_encoder(state, out)


@njit(cache=True)
def decode_classes(
    starts: NDArray[np.int64], tick: NDArray[np.int32], model: NDArray[np.uint16], data: NDArray[np.uint8]
) -> tuple[NDArray[np.uint8], bool]:
    """Inverse of :func:`encode_classes`; the classes and whether the data sufficed."""
    value = np.zeros(len(tick), np.uint8)
    state = start_decoder(data)
    above = 0
    for k in range(len(starts) - 1):
        begin = starts[k]
        j = above
        left = 0
        for i in range(begin, starts[k + 1]):
            while j + 1 < begin and tick[j] < tick[i]:
                j += 1
            up = np.int64(value[j]) if j < begin else 0
            node = 1
            for _bit in range(BITS):
                node = node << 1 | decode_bit(state, data, model, (left * _TREE + up) * _TREE + node)
            left = node - _TREE
            value[i] = left
        if starts[k + 1] > begin:
            above = begin
    return value, state[3] == 0
