"""Class of each return: adaptive bits in the context of the classes to the left and above."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.entropy.walks import code_tree, finish_coder, start_coder, uncounted

BITS = 5  # 32 classes at most
_TREE = 1 << BITS
CONTEXTS = _TREE * _TREE * _TREE


@uncounted
def _walk(
    writing: bool,
    state: NDArray[np.int64],
    starts: NDArray[np.int64],
    tick: NDArray[np.int32],
    value: NDArray[np.uint8],
    model: NDArray[np.uint16],
    buffer: NDArray[np.uint8],
) -> int:
    above = 0
    for k in range(len(starts) - 1):
        begin = starts[k]
        j = above
        left = np.int64(0)
        for i in range(begin, starts[k + 1]):
            while j + 1 < begin and tick[j] < tick[i]:
                j += 1
            up = np.int64(value[j]) if j < begin else 0
            context = (left * _TREE + up) * _TREE
            left = np.int64(code_tree(writing, state, buffer, model, context, BITS, value[i]))
            value[i] = left
        if starts[k + 1] > begin:
            above = begin
    return finish_coder(writing, state, buffer)


@njit(cache=True)
def encode_classes(
    starts: NDArray[np.int64],
    tick: NDArray[np.int32],
    value: NDArray[np.uint8],
    model: NDArray[np.uint16],
    out: NDArray[np.uint8],
) -> int:
    """Encode classes below 32 ``(M,)``; return the bytes written to ``out``, -1 if full."""
    return _walk(True, start_coder(True, out), starts, tick, value.copy(), model, out)


@njit(cache=True)
def decode_classes(
    starts: NDArray[np.int64], tick: NDArray[np.int32], model: NDArray[np.uint16], data: NDArray[np.uint8]
) -> tuple[NDArray[np.uint8], bool]:
    """Inverse of :func:`encode_classes`; the classes and whether the data sufficed."""
    value = np.zeros(len(tick), np.uint8)
    return value, _walk(False, start_coder(False, data), starts, tick, value, model, data) == 0
