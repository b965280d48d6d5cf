"""Range coder: bits with adaptive probabilities, and intervals of a given distribution.

A carry-propagating byte-wise range coder (Martin 1979) with 48-bit range, so that 16-bit distributions
lose nothing to rounding. All arithmetic is integer.

State of an encoder is an int64 array ``[low, range, position, overflow]`` beside a uint8 buffer; a
decoder's is ``[code, range, position, overrun]`` beside the bytes. Neither ever reads or writes outside
its buffer: an encoder that runs out of room sets ``overflow``, a decoder that runs out of bytes reads
zeros and sets ``overrun``, and the caller checks.

Adaptive bits live in a uint16 array ``(contexts, 2)``: a fast and a slow estimate of the probability
of 0, in 1/65536, whose mean is used.

A bit is applied by masks instead of branches, which no predictor could guess: 4 ns a bit instead of 30.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

_TOP = 1 << 48
_BOTTOM = 1 << 40
_MASK = _TOP - 1
_FAST = 4
_SLOW = 7
_SLACK = 8  # zero bytes that a decoder may read past the end


def new_bits(contexts: int) -> NDArray[np.uint16]:
    """Return adaptive probabilities for ``contexts`` bit contexts, all at one half."""
    return np.full((contexts, 2), 1 << 15, np.uint16)


@njit(cache=True)
def start_encoder() -> NDArray[np.int64]:
    """Return the state of a fresh encoder."""
    state = np.zeros(4, np.int64)
    state[1] = _MASK
    return state


@njit(cache=True, _nrt=False)
def _renormalise_encoder(low: int, width: int, state: NDArray[np.int64], out: NDArray[np.uint8]) -> None:
    """Write out the leading bytes of ``low`` until the range is wide again; carries ripple back."""
    position = state[2]
    while width < _BOTTOM:
        width <<= 8
        if low > _MASK:
            p = min(position, len(out)) - 1
            while p >= 0 and out[p] == 255:
                out[p] = 0
                p -= 1
            if p >= 0:
                out[p] += 1
            low &= _MASK
        if position < len(out):
            out[position] = low >> 40
        else:
            state[3] = 1
        position += 1
        low = (low & (_BOTTOM - 1)) << 8
    state[0] = low
    state[1] = width
    state[2] = position


@njit(cache=True, _nrt=False)
def encode_interval(
    state: NDArray[np.int64], out: NDArray[np.uint8], low: int, width: int, bits: int
) -> None:
    """Encode the interval ``[low, low + width)`` of ``2 ** bits``; width at least 1, bits at most 24."""
    r = state[1] >> bits
    _renormalise_encoder(state[0] + r * low, max(r * width, 1), state, out)


@njit(cache=True, _nrt=False)
def _weight(model: NDArray[np.uint16], context: int) -> int:
    """Sum of the two estimates of a context."""
    return int(np.int64(model[context, 0]) + np.int64(model[context, 1]))


@njit(cache=True, _nrt=False)
def _adapt(model: NDArray[np.uint16], context: int, goal: int) -> None:
    """Move the two estimates of a context towards ``goal``, 0 or 65535."""
    fast = np.int64(model[context, 0])
    slow = np.int64(model[context, 1])
    model[context, 0] = fast + ((goal - fast) >> _FAST)
    model[context, 1] = slow + ((goal - slow) >> _SLOW)


@njit(cache=True, _nrt=False)
def encode_bit(
    state: NDArray[np.int64], out: NDArray[np.uint8], model: NDArray[np.uint16], context: int, bit: int
) -> None:
    """Encode one bit in a context of ``model`` and adapt the context.

    >>> out, model = np.zeros(16, np.uint8), new_bits(1)
    >>> state = start_encoder()
    >>> for bit in (0, 0, 1, 0):
    ...     encode_bit(state, out, model, 0, bit)
    >>> data, model = out[: finish_encoder(state, out)], new_bits(1)
    >>> state = start_decoder(data)
    >>> [decode_bit(state, data, model, 0) for _ in range(4)]
    [0, 0, 1, 0]
    """
    zero = min(max(_weight(model, context) >> 1, 32), 65504)
    width = state[1]
    bound = (width >> 16) * zero
    one = -np.int64(bit)
    _adapt(model, context, 65535 & ~one)
    _renormalise_encoder(state[0] + (bound & one), bound + ((width - bound - bound) & one), state, out)


@njit(cache=True, _nrt=False)
def encode_mixed_bit(
    state: NDArray[np.int64],
    out: NDArray[np.uint8],
    first: NDArray[np.uint16],
    i: int,
    second: NDArray[np.uint16],
    j: int,
    bit: int,
) -> None:
    """Encode one bit by the mean of two contexts, ``first[i]`` and ``second[j]``, and adapt both."""
    zero = min(max((_weight(first, i) + _weight(second, j)) >> 2, 32), 65504)
    width = state[1]
    bound = (width >> 16) * zero
    one = -np.int64(bit)
    goal = 65535 & ~one
    _adapt(first, i, goal)
    _adapt(second, j, goal)
    _renormalise_encoder(state[0] + (bound & one), bound + ((width - bound - bound) & one), state, out)


@njit(cache=True, _nrt=False)
def finish_encoder(state: NDArray[np.int64], out: NDArray[np.uint8]) -> int:
    """Flush; return the number of bytes written, or -1 if the buffer was too small."""
    for _ in range(6):
        _renormalise_encoder(state[0], _BOTTOM - 1, state, out)
    if state[3] != 0:
        return -1
    # The decoder reads a few zeros past the end, so that many need not be kept.
    end = state[2]
    while end > 0 and end > state[2] - _SLACK and out[end - 1] == 0:
        end -= 1
    return end


@njit(cache=True)
def start_decoder(data: NDArray[np.uint8]) -> NDArray[np.int64]:
    """Return the state of a decoder at the start of ``data``."""
    state = np.zeros(4, np.int64)
    for i in range(6):
        state[0] = (state[0] << 8) | (np.int64(data[i]) if i < len(data) else 0)
    state[1] = _MASK
    state[2] = 6
    return state


@njit(cache=True, _nrt=False)
def _renormalise_decoder(code: int, width: int, state: NDArray[np.int64], data: NDArray[np.uint8]) -> None:
    while width < _BOTTOM:
        width <<= 8
        position = state[2]
        byte = np.int64(0)
        if position < len(data):
            byte = np.int64(data[position])
        elif position >= len(data) + _SLACK:
            state[3] = 1
        state[2] = position + 1
        code = int(((code << 8) | byte) & _MASK)
    state[0] = code
    state[1] = width


@njit(cache=True, _nrt=False)
def decode_target(state: NDArray[np.int64], bits: int) -> int:
    """Return where in ``[0, 2 ** bits)`` the next symbol lies; follow with :func:`decode_interval`."""
    return min(state[0] // (state[1] >> bits), (1 << bits) - 1)


@njit(cache=True, _nrt=False)
def decode_interval(
    state: NDArray[np.int64], data: NDArray[np.uint8], low: int, width: int, bits: int
) -> None:
    """Consume the interval ``[low, low + width)`` that holds the target; inverse of encode_interval."""
    r = state[1] >> bits
    # A model that gives an interval no width must not stop the decoder; the checksum will tell.
    _renormalise_decoder(state[0] - r * low, max(r * width, 1), state, data)


@njit(cache=True, _nrt=False)
def decode_bit(
    state: NDArray[np.int64], data: NDArray[np.uint8], model: NDArray[np.uint16], context: int
) -> int:
    """Decode one bit; inverse of :func:`encode_bit`."""
    zero = min(max(_weight(model, context) >> 1, 32), 65504)
    code = state[0]
    width = state[1]
    bound = (width >> 16) * zero
    bit = np.int64(code >= bound)
    one = -bit
    _adapt(model, context, 65535 & ~one)
    _renormalise_decoder(code - (bound & one), bound + ((width - bound - bound) & one), state, data)
    return int(bit)


@njit(cache=True, _nrt=False)
def decode_mixed_bit(
    state: NDArray[np.int64],
    data: NDArray[np.uint8],
    first: NDArray[np.uint16],
    i: int,
    second: NDArray[np.uint16],
    j: int,
) -> int:
    """Decode one bit; inverse of :func:`encode_mixed_bit`."""
    zero = min(max((_weight(first, i) + _weight(second, j)) >> 2, 32), 65504)
    code = state[0]
    width = state[1]
    bound = (width >> 16) * zero
    bit = np.int64(code >= bound)
    one = -bit
    goal = 65535 & ~one
    _adapt(first, i, goal)
    _adapt(second, j, goal)
    _renormalise_decoder(code - (bound & one), bound + ((width - bound - bound) & one), state, data)
    return int(bit)
