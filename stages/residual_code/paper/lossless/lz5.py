"""LZ5 v1 in its published block format (lz5_Block_format.md of inikep/lz5, 2016-01-22); the matcher is our own.

A sequence is a token, literals, and a match:

    1_OO_LL_MMM  + 1 byte    10-bit offset          00_LLL_MMM + 2 bytes    16-bit offset
    010_LL_MMM   + 3 bytes   24-bit offset          011_LL_MMM              the last offset

A length field that is full goes on in bytes of up to 255. Matches have at least 3 bytes; the last 5 bytes are
literals, and the last match starts at least 12 bytes before the end.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.entropy.buffer import as_array
from salpcc.stages.residual_code.paper.lossless.lossless_coder import Lossless, checked
from salpcc.stages.residual_code.paper.lossless.matches import length_at, longest, new_chains, remember

_TITLE = "LZ5"
_LAST_LITERALS, _LAST_MATCH, _MINIMUM = 5, 12, 3
_WINDOW = (1 << 24) - 1


@njit(cache=True)
def _put_length(out: NDArray[np.uint8], at: int, rest: int) -> int:
    while rest >= 255:
        out[at] = 255
        at += 1
        rest -= 255
    out[at] = rest
    return at + 1


@njit(cache=True)
def _put(
    out: NDArray[np.uint8],
    at: int,
    src: NDArray[np.uint8],
    start: int,
    end: int,
    offset: int,
    last: int,
    n: int,
) -> int:
    """Write one sequence: literals ``start`` to ``end``, then a match of ``n`` bytes (0: none, the end)."""
    literals = end - start
    wide = n == 0 or (offset != last and 1024 <= offset < 65536)
    most = 7 if wide else 3
    token = min(literals, most) << 3 | min(max(n - _MINIMUM, 0), 7)
    if not wide:
        if offset == last:
            token |= 0x60
        elif offset < 1024:
            token |= 0x80 | (offset >> 8) << 5
        else:
            token |= 0x40
    out[at] = token
    at += 1
    if literals >= most:
        at = _put_length(out, at, literals - most)
    out[at : at + literals] = src[start:end]
    at += literals
    if n == 0:
        return at
    if offset != last:
        size = 1 if offset < 1024 else (2 if offset < 65536 else 3)
        for k in range(size):
            out[at] = (offset >> (8 * k)) & 255
            at += 1
    if n - _MINIMUM >= 7:
        at = _put_length(out, at, n - _MINIMUM - 7)
    return at


@njit(cache=True)
def _encode(src: NDArray[np.uint8], out: NDArray[np.uint8]) -> int:
    size = len(src)
    head, before = new_chains(size)
    end = size - _LAST_LITERALS
    at, start, written, last = 0, 0, 0, 0
    while at < size - _LAST_MATCH:
        offset, n = longest(src, at, end, _WINDOW, head, before)
        again = length_at(src, at, last, end)
        if again >= _MINIMUM and again + 2 >= n:
            offset, n = last, again
        if n < _MINIMUM or (offset >= 65536 and offset != last and n < 6):
            remember(src, at, head, before)
            at += 1
            continue
        written = _put(out, written, src, start, at, offset, last, n)
        last = offset
        for place in range(at, at + n):
            remember(src, place, head, before)
        at += n
        start = at
    return _put(out, written, src, start, size, 0, 0, 0)


@njit(cache=True)
def _length(data: NDArray[np.uint8], at: int, field: int, most: int) -> tuple[int, int]:
    """Read the rest of a length; the place is -1 where the data end."""
    if field < most:
        return field, at
    while at < len(data):
        byte = np.int64(data[at])
        at += 1
        field += int(byte)
        if byte < 255:
            return field, at
    return 0, -1


@njit(cache=True)
def _decode(data: NDArray[np.uint8], out: NDArray[np.uint8]) -> int:
    """Expand into ``out``; return the bytes written, -1 where the data make no sense."""
    at, done, last = 0, 0, 0
    while at < len(data):
        token = np.int64(data[at])
        at += 1
        wide = token >> 6 == 0
        literals, at = _length(data, at, (token >> 3) & (7 if wide else 3), 7 if wide else 3)
        if at < 0 or literals > len(data) - at or literals > len(out) - done:
            return -1
        out[done : done + literals] = data[at : at + literals]
        at += literals
        done += literals
        if at == len(data):
            return done
        if token >> 5 != 3:
            size = 1 if token >= 128 else (2 if wide else 3)
            if at + size > len(data):
                return -1
            last = int((token >> 5 & 3) << 8) if token >= 128 else 0
            for k in range(size):
                last |= int(np.int64(data[at + k]) << (8 * k))
            at += size
        n, at = _length(data, at, token & 7, 7)
        n += _MINIMUM
        if at < 0 or last == 0 or last > done or n > len(out) - done:
            return -1
        for k in range(done, done + n):
            out[k] = out[k - last]
        done += n
    return -1  # the last sequence has no match


def encode(plain: bytes) -> bytes:
    """Compress; see the contract."""
    out = np.empty(len(plain) + len(plain) // 200 + 64, np.uint8)
    return out[: _encode(as_array(plain), out)].tobytes()


def decode(data: bytes, size: int) -> bytes:
    """Expand; inverse of :func:`encode`."""
    out = np.empty(size, np.uint8)
    done = int(_decode(as_array(data), out))
    return checked(_TITLE, out[: max(done, 0)].tobytes(), size, done >= 0)


LZ5 = Lossless(_TITLE, "v1, greedy matches, 16 MiB window", encode, decode)
