"""Code bytes with a range coder and static order-0 frequencies, as PCL's octree codec does.

The frequencies go in front, scaled to 12 bits and packed by zlib (PCL writes 2 kB of them plainly). The coder is
the carry-less one of Subbotin, which PCL uses too.
"""

from __future__ import annotations

import struct
import zlib

import numpy as np
from numba import njit
from numpy.typing import NDArray

_BITS = 14
_TOTAL = 1 << _BITS
_TOP = np.uint64(1 << 24)
_BOTTOM = np.uint64(1 << 16)
_MASK = np.uint64(0xFFFFFFFF)
_HEAD = struct.Struct("<IH")  # symbols, bytes of the packed frequencies


def encode_bytes(symbols: NDArray[np.uint8]) -> bytes:
    """Code ``(N,)`` bytes."""
    frequencies = _scaled(np.bincount(symbols, minlength=256)) if len(symbols) else np.zeros(256, np.uint16)
    table = zlib.compress(frequencies.tobytes(), 9)
    stream = _encode(symbols, _cumulative(frequencies), np.empty(2 * len(symbols) + 16, np.uint8))
    return _HEAD.pack(len(symbols), len(table)) + table + bytes(stream.tobytes())


def decode_bytes(data: bytes) -> NDArray[np.uint8]:
    """Decode what :func:`encode_bytes` wrote."""
    count, size = _HEAD.unpack_from(data)
    frequencies = np.frombuffer(zlib.decompress(data[_HEAD.size : _HEAD.size + size]), np.uint16)
    stream = np.frombuffer(data[_HEAD.size + size :] + bytes(8), np.uint8)
    return np.asarray(_decode(stream, _cumulative(frequencies), int(count)))


def _scaled(counts: NDArray[np.int64]) -> NDArray[np.uint16]:
    """Scale counts to sum to 2^14, none that occurs to 0; the most frequent takes the rounding."""
    scaled = np.where(counts > 0, np.maximum(1, counts * (_TOTAL - 256) // counts.sum()), 0)
    scaled[np.argmax(scaled)] += _TOTAL - scaled.sum()
    return scaled.astype(np.uint16)


def _cumulative(frequencies: NDArray[np.uint16]) -> NDArray[np.uint64]:
    return np.concatenate([[0], np.cumsum(frequencies, dtype=np.uint64)]).astype(np.uint64)


@njit(cache=True)
def _encode(
    symbols: NDArray[np.uint8], cumulative: NDArray[np.uint64], out: NDArray[np.uint8]
) -> NDArray[np.uint8]:
    low, span, size = np.uint64(0), _MASK, 0
    for symbol in symbols:
        start = cumulative[symbol]
        span = span >> np.uint64(_BITS)
        low = (low + start * span) & _MASK
        span = span * (cumulative[np.int64(symbol) + 1] - start)
        while True:
            if (low ^ (low + span)) >= _TOP:
                if span >= _BOTTOM:
                    break
                span = (np.uint64(0) - low) & (_BOTTOM - np.uint64(1))
            out[size] = np.uint8(low >> np.uint64(24))
            size += 1
            low = (low << np.uint64(8)) & _MASK
            span = (span << np.uint64(8)) & _MASK
    for _ in range(4):
        out[size] = np.uint8(low >> np.uint64(24))
        size += 1
        low = (low << np.uint64(8)) & _MASK
    return out[:size]


@njit(cache=True)
def _decode(stream: NDArray[np.uint8], cumulative: NDArray[np.uint64], count: int) -> NDArray[np.uint8]:
    symbols = np.empty(count, np.uint8)
    slot = np.empty(_TOTAL, np.uint8)
    for symbol in range(256):
        slot[cumulative[symbol] : cumulative[symbol + 1]] = symbol
    low, span, code, place = np.uint64(0), _MASK, np.uint64(0), 0
    for _ in range(4):
        code = (code << np.uint64(8)) | np.uint64(stream[place])
        place += 1
    for i in range(count):
        span = span >> np.uint64(_BITS)
        value = ((code - low) & _MASK) // span
        symbol = slot[min(value, np.uint64(_TOTAL - 1))]
        symbols[i] = symbol
        start = cumulative[symbol]
        low = (low + start * span) & _MASK
        span = span * (cumulative[np.int64(symbol) + 1] - start)
        while True:
            if (low ^ (low + span)) >= _TOP:
                if span >= _BOTTOM:
                    break
                span = (np.uint64(0) - low) & (_BOTTOM - np.uint64(1))
            code = ((code << np.uint64(8)) & _MASK) | np.uint64(stream[min(place, len(stream) - 1)])
            place += 1
            low = (low << np.uint64(8)) & _MASK
            span = (span << np.uint64(8)) & _MASK
    return symbols
