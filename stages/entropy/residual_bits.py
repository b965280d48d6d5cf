"""One whole number in two contexts, written or read: zero or not, sign, size in unary, the bits below the leading one.

Every bit is coded by the mean of the two contexts; of the bits below the leading one the first two adapt, the others
are even. One function for both directions, so that they cannot drift apart.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numba.cpython.unsafe.numbers import leading_zeros  # one instruction of the processor
from numpy.typing import NDArray

from salpcc.stages.entropy.walks import code_mixed_bit, code_raw

SIZES = 40  # magnitudes below 2 ** 40
CLASSES = SIZES // 2 + 1  # of sizes, as contexts
PER_CONTEXT = 2 + 4 * SIZES

State = NDArray[np.int64]
Bytes = NDArray[np.uint8]
Bits = NDArray[np.uint16]


@njit(cache=True)
def size_of(magnitude: int) -> int:
    """Number of bits of a magnitude."""
    return int(64 - leading_zeros(np.int64(magnitude)))


# A call would lay seven words of each array on the stack, which takes as long as the bits that a number has left.
@njit(cache=True, forceinline=True, _nrt=False)
def code_number(
    writing: bool, state: State, data: Bytes, first: Bits, i: int, second: Bits, j: int, value: int
) -> int:
    """Write ``value``, magnitude below ``2 ** SIZES``, or read and return it; i and j count contexts of PER_CONTEXT bits."""
    a = i * PER_CONTEXT
    b = j * PER_CONTEXT
    magnitude = abs(value)
    if code_mixed_bit(writing, state, data, first, a, second, b, np.int64(magnitude != 0)) == 0:
        return 0
    negative = code_mixed_bit(writing, state, data, first, a + 1, second, b + 1, np.int64(value < 0))
    wanted = size_of(magnitude) - 1
    size = 0
    while size < SIZES - 1:
        at = 2 + 4 * size
        if code_mixed_bit(writing, state, data, first, a + at, second, b + at, np.int64(size < wanted)) == 0:
            break
        size += 1
    found = 1
    at = 2 + 4 * size
    for known in range(min(size, 2)):
        node = at + 1 + (0 if known == 0 else found & 1) + known
        bit = (magnitude >> (size - 1 - known)) & 1
        found = found << 1 | code_mixed_bit(writing, state, data, first, a + node, second, b + node, bit)
    rest = max(size - 2, 0)
    while rest > 0:
        some = min(rest, 16)
        rest -= some
        found = found << some | code_raw(writing, state, data, some, magnitude >> rest)
    return -found if negative else found
