"""Range coder: bits with adaptive probabilities, and intervals of a given distribution.

A carry-propagating byte-wise range coder (Martin 1979, in the form of 7-Zip's) with 48-bit range, so
that 16-bit distributions lose nothing to rounding. All arithmetic is integer.

State of an encoder is an int64 array ``[low, range, cache, pending, position, overflow]`` beside a
uint8 buffer; a decoder's is ``[code, range, position, overrun]`` beside the bytes. Neither ever
reads or writes outside its buffer: an encoder that runs out of room sets ``overflow``, a decoder
that runs out of bytes reads zeros and sets ``overrun``, and the caller checks.

Adaptive bits live in a uint16 array ``(contexts, 2)``: a fast and a slow estimate of the probability
of 0, in 1/65536, whose mean is used.
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
    state = np.zeros(6, np.int64)
    state[1] = _MASK
    state[3] = 1
    return state


@njit(cache=True)
def _put(state: NDArray[np.int64], out: NDArray[np.uint8], value: int) -> None:
    if state[4] < len(out):
        out[state[4]] = value & 255
        state[4] += 1
    else:
        state[5] = 1


@njit(cache=True)
def _shift_low(state: NDArray[np.int64], out: NDArray[np.uint8]) -> None:
    low = state[0]
    if low < (255 << 40) or low > _MASK:
        carry = low >> 48
        _put(state, out, state[2] + carry)
        for _ in range(state[3] - 1):
            _put(state, out, 255 + carry)
        state[3] = 0
        state[2] = (low >> 40) & 255
    state[3] += 1
    state[0] = (low & (_BOTTOM - 1)) << 8


@njit(cache=True)
def encode_interval(
    state: NDArray[np.int64], out: NDArray[np.uint8], low: int, width: int, bits: int
) -> None:
    """Encode the interval ``[low, low + width)`` of ``2 ** bits``; width at least 1, bits at most 24."""
    r = state[1] >> bits
    state[0] += r * low
    state[1] = r * width
    while state[1] < _BOTTOM:
        state[1] <<= 8
        _shift_low(state, out)


@njit(cache=True)
def encode_bit(
    state: NDArray[np.int64], out: NDArray[np.uint8], model: NDArray[np.uint16], context: int, bit: int
) -> None:
    """Encode one bit in a context of ``model`` and adapt the context."""
    fast = np.int64(model[context, 0])
    slow = np.int64(model[context, 1])
    zero = (fast + slow) >> 1
    zero = min(max(zero, 32), 65504)
    bound = (state[1] >> 16) * zero
    if bit == 0:
        state[1] = bound
        model[context, 0] = fast + ((65535 - fast) >> _FAST)
        model[context, 1] = slow + ((65535 - slow) >> _SLOW)
    else:
        state[0] += bound
        state[1] -= bound
        model[context, 0] = fast - (fast >> _FAST)
        model[context, 1] = slow - (slow >> _SLOW)
    while state[1] < _BOTTOM:
        state[1] <<= 8
        _shift_low(state, out)


@njit(cache=True)
def finish_encoder(state: NDArray[np.int64], out: NDArray[np.uint8]) -> int:
    """Flush; return the number of bytes written, or -1 if the buffer was too small."""
    for _ in range(7):
        _shift_low(state, out)
    if state[5] != 0:
        return -1
    # The decoder reads a few zeros past the end, so that many need not be kept.
    end = state[4]
    while end > 0 and end > state[4] - _SLACK and out[end - 1] == 0:
        end -= 1
    return end


@njit(cache=True)
def _get(state: NDArray[np.int64], data: NDArray[np.uint8]) -> int:
    position = state[2]
    state[2] = position + 1
    if position < len(data):
        return np.int64(data[position])
    if position >= len(data) + _SLACK:
        state[3] = 1
    return 0


@njit(cache=True)
def start_decoder(data: NDArray[np.uint8]) -> NDArray[np.int64]:
    """Return the state of a decoder at the start of ``data``."""
    state = np.zeros(4, np.int64)
    state[1] = _MASK
    for _ in range(7):
        state[0] = (state[0] << 8) | _get(state, data)
    state[0] &= _MASK
    return state


@njit(cache=True)
def decode_target(state: NDArray[np.int64], bits: int) -> int:
    """Return where in ``[0, 2 ** bits)`` the next symbol lies; follow with :func:`decode_interval`."""
    return min(state[0] // (state[1] >> bits), (1 << bits) - 1)


@njit(cache=True)
def decode_interval(
    state: NDArray[np.int64], data: NDArray[np.uint8], low: int, width: int, bits: int
) -> None:
    """Consume the interval ``[low, low + width)`` that holds the target; inverse of encode_interval."""
    r = state[1] >> bits
    state[0] -= r * low
    state[1] = r * width
    while state[1] < _BOTTOM:
        state[1] <<= 8
        state[0] = ((state[0] << 8) | _get(state, data)) & _MASK


@njit(cache=True)
def decode_bit(
    state: NDArray[np.int64], data: NDArray[np.uint8], model: NDArray[np.uint16], context: int
) -> int:
    """Decode one bit; inverse of :func:`encode_bit`."""
    fast = np.int64(model[context, 0])
    slow = np.int64(model[context, 1])
    zero = (fast + slow) >> 1
    zero = min(max(zero, 32), 65504)
    bound = (state[1] >> 16) * zero
    if state[0] < bound:
        bit = 0
        state[1] = bound
        model[context, 0] = fast + ((65535 - fast) >> _FAST)
        model[context, 1] = slow + ((65535 - slow) >> _SLOW)
    else:
        bit = 1
        state[0] -= bound
        state[1] -= bound
        model[context, 0] = fast - (fast >> _FAST)
        model[context, 1] = slow - (slow >> _SLOW)
    while state[1] < _BOTTOM:
        state[1] <<= 8
        state[0] = ((state[0] << 8) | _get(state, data)) & _MASK
    return bit
