"""Lizard (LIZv1) in its published block format (doc/lizard_Block_format.md of inikep/lizard); our own matcher.

A byte of the level, then blocks of at most 128 KiB: a header byte and five streams (lengths, 16-bit offsets, 24-bit
offsets, tokens, literals), each a 3-byte length and its bytes; or 128, a 3-byte length, and the bytes as they are.
Streams may be compressed by Huff0 at levels 30 and above; that is not done here, and refused.

    0_MMMM_LLL   3-bit literal length, next 16-bit offset, match of 4 or more
    1_MMMM_LLL   3-bit literal length, last offset
    0 ... 31     no literals, next 24-bit offset, match of 16 + token or (31) more
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.entropy.buffer import as_array
from salpcc.stages.residual_code.paper.lossless.lossless_coder import Lossless, checked
from salpcc.stages.residual_code.paper.lossless.matches import length_at, longest, new_chains, remember

_TITLE, _LEVEL = "Lizard", 20
_BLOCK = 1 << 17
_PLAIN = 128
_LAST_LITERALS, _LAST_MATCH = 16, 20
_WINDOW = (1 << 24) - 1
_STREAMS = 5
_LENGTHS, _NEAR, _FAR, _TOKENS, _LITERALS = range(_STREAMS)


@njit(cache=True)
def _put(streams: NDArray[np.uint8], sizes: NDArray[np.int64], stream: int, value: int, n: int) -> None:
    """Append ``n`` bytes of a value, little end first."""
    for k in range(n):
        streams[stream, sizes[stream]] = (value >> (8 * k)) & 255
        sizes[stream] += 1


@njit(cache=True)
def _put_length(streams: NDArray[np.uint8], sizes: NDArray[np.int64], rest: int) -> None:
    if rest < 254:
        _put(streams, sizes, _LENGTHS, rest, 1)
    elif rest < 65536:
        _put(streams, sizes, _LENGTHS, 254 | rest << 8, 3)
    else:
        _put(streams, sizes, _LENGTHS, 255 | rest << 8, 4)


@njit(cache=True)
def _put_sequence(
    streams: NDArray[np.uint8],
    sizes: NDArray[np.int64],
    src: NDArray[np.uint8],
    start: int,
    at: int,
    offset: int,
    last: int,
    n: int,
) -> None:
    literals = at - start
    for place in range(start, at):
        _put(streams, sizes, _LITERALS, src[place], 1)
    near = offset < 65536 and offset != last
    far = offset >= 65536 and offset != last
    if not far or literals > 0:
        # Literals before a far match take a token of their own: the last offset, over no bytes.
        match = 0 if far else n
        _put(streams, sizes, _TOKENS, (0 if near else 128) | min(match, 15) << 3 | min(literals, 7), 1)
        if literals >= 7:
            _put_length(streams, sizes, literals - 7)
        if near:
            _put(streams, sizes, _NEAR, offset, 2)
        if match >= 15:
            _put_length(streams, sizes, match - 15)
    if far:
        _put(streams, sizes, _TOKENS, min(n - 16, 31), 1)
        _put(streams, sizes, _FAR, offset, 3)
        if n >= 47:
            _put_length(streams, sizes, n - 47)


@njit(cache=True)
def _encode(src: NDArray[np.uint8], out: NDArray[np.uint8]) -> int:
    head, before = new_chains(len(src))
    out[0] = _LEVEL
    written, last = 1, 0
    for first in range(0, len(src), _BLOCK):
        stop = min(first + _BLOCK, len(src))
        streams = np.empty((_STREAMS, stop - first + 16), np.uint8)
        sizes = np.zeros(_STREAMS, np.int64)
        at, start, began = first, first, last
        while at < stop - _LAST_MATCH:
            end = stop - _LAST_LITERALS
            offset, n = longest(src, at, end, _WINDOW, head, before)
            again = length_at(src, at, last, end)
            if again >= 3 and again + 2 >= n:
                offset, n = last, again
            if n < 3 or (offset >= 65536 and offset != last and n < 16):
                remember(src, at, head, before)
                at += 1
                continue
            _put_sequence(streams, sizes, src, start, at, offset, last, n)
            last = offset
            for place in range(at, at + n):
                remember(src, place, head, before)
            at += n
            start = at
        for place in range(start, stop):
            _put(streams, sizes, _LITERALS, src[place], 1)
        for place in range(at, stop):
            remember(src, place, head, before)
        if sizes.sum() + 3 * _STREAMS >= stop - first + 3:
            last = began  # what was found is not written
            out[written] = _PLAIN
            for k in range(3):
                out[written + 1 + k] = ((stop - first) >> (8 * k)) & 255
            out[written + 4 : written + 4 + stop - first] = src[first:stop]
            written += 4 + stop - first
            continue
        out[written] = 0
        written += 1
        for stream in range(_STREAMS):
            for k in range(3):
                out[written + k] = (sizes[stream] >> (8 * k)) & 255
            out[written + 3 : written + 3 + sizes[stream]] = streams[stream, : sizes[stream]]
            written += 3 + sizes[stream]
    return written


@njit(cache=True)
def _take(
    data: NDArray[np.uint8], ends: NDArray[np.int64], places: NDArray[np.int64], stream: int, n: int
) -> int:
    """Read ``n`` bytes of a stream, little end first; -1 where it ends."""
    if places[stream] + n > ends[stream]:
        return -1
    value = 0
    for k in range(n):
        value |= int(np.int64(data[places[stream] + k]) << (8 * k))
    places[stream] += n
    return value


@njit(cache=True)
def _take_length(data: NDArray[np.uint8], ends: NDArray[np.int64], places: NDArray[np.int64]) -> int:
    value = _take(data, ends, places, _LENGTHS, 1)
    return value if value < 254 else _take(data, ends, places, _LENGTHS, 2 if value == 254 else 3)


@njit(cache=True)
def _decode_block(
    data: NDArray[np.uint8],
    ends: NDArray[np.int64],
    places: NDArray[np.int64],
    out: NDArray[np.uint8],
    done: int,
    last: int,
) -> tuple[int, int]:
    """Expand one block; returns the bytes there are then, -1 where it makes no sense, and the last offset."""
    while places[_TOKENS] < ends[_TOKENS]:
        token = _take(data, ends, places, _TOKENS, 1)
        literals, extra = 0, 0
        if token >= 32:
            literals = token & 7
            if literals == 7:
                extra = _take_length(data, ends, places)
                literals += extra
            if extra < 0 or literals > ends[_LITERALS] - places[_LITERALS] or literals > len(out) - done:
                return -1, 0
            begin = places[_LITERALS]
            out[done : done + literals] = data[begin : begin + literals]
            places[_LITERALS] += literals
            done += literals
            if token < 128:
                last = _take(data, ends, places, _NEAR, 2)
            n, full = (token >> 3) & 15, 15
        else:
            last = _take(data, ends, places, _FAR, 3)
            n, full = token + 16, 47
        if n == full:
            extra = _take_length(data, ends, places)
            n += extra
        if extra < 0 or last < 0 or n > len(out) - done or (n > 0 and (last == 0 or last > done)):
            return -1, 0
        for k in range(done, done + n):
            out[k] = out[k - last]
        done += n
    rest = ends[_LITERALS] - places[_LITERALS]
    left_over = (places[:_TOKENS] < ends[:_TOKENS]).any()
    if left_over or rest > len(out) - done:
        return -1, 0
    out[done : done + rest] = data[places[_LITERALS] : ends[_LITERALS]]
    return done + rest, last


@njit(cache=True)
def _three(data: NDArray[np.uint8], at: int) -> int:
    if at + 3 > len(data):
        return len(data)  # more than there can be
    return int(np.int64(data[at]) | np.int64(data[at + 1]) << 8 | np.int64(data[at + 2]) << 16)


@njit(cache=True)
def _decode(data: NDArray[np.uint8], out: NDArray[np.uint8]) -> int:
    """Expand into ``out``; return the bytes written, -1 where the data make no sense."""
    if len(data) == 0:
        return -1
    at, done, last = 1, 0, 0
    ends, places = np.zeros(_STREAMS, np.int64), np.zeros(_STREAMS, np.int64)
    while at < len(data):
        header = data[at]
        at += 1
        if header == _PLAIN:
            size = _three(data, at)
            if size > len(data) - at - 3 or size > len(out) - done:
                return -1
            out[done : done + size] = data[at + 3 : at + 3 + size]
            at += 3 + size
            done += size
            continue
        if header != 0:
            return -1
        for stream in range(_STREAMS):
            size = _three(data, at)
            if size > len(data) - at - 3:
                return -1
            places[stream] = at + 3
            ends[stream] = at + 3 + size
            at = ends[stream]
        done, last = _decode_block(data, ends, places, out, done, last)
        if done < 0:
            return -1
    return done


def encode(plain: bytes) -> bytes:
    """Compress; see the contract."""
    out = np.empty(len(plain) + 4 * (len(plain) // _BLOCK + 1) + 64, np.uint8)
    return out[: _encode(as_array(plain), out)].tobytes()


def decode(data: bytes, size: int) -> bytes:
    """Expand; inverse of :func:`encode`."""
    out = np.empty(size, np.uint8)
    done = int(_decode(as_array(data), out))
    return checked(_TITLE, out[: max(done, 0)].tobytes(), size, done >= 0)


LIZARD = Lossless(_TITLE, f"level {_LEVEL} (LIZv1, no Huff0), greedy matches", encode, decode)
