"""Bytes that hardly differ from others: the heads of messages, scan by scan."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.schemas.errors import ArchiveError
from salpcc.stages.entropy.range_coder import (
    decode_bit,
    encode_bit,
    finish_encoder,
    new_bits,
    start_decoder,
    start_encoder,
)


@njit(cache=True)
def _encode(
    now: NDArray[np.uint8], before: NDArray[np.uint8], bits: NDArray[np.uint16], out: NDArray[np.uint8]
) -> int:
    state = start_encoder()
    same = 1
    for i in range(len(now)):
        expected = before[i] if i < len(before) else np.uint8(0)
        hit = 1 if now[i] == expected else 0
        encode_bit(state, out, bits, 256 + same, hit)
        same = hit
        node = 1
        if hit == 0:
            for shift in range(7, -1, -1):
                bit = (np.int64(now[i]) >> shift) & 1
                encode_bit(state, out, bits, node, bit)
                node = node * 2 + bit
    return finish_encoder(state, out)


@njit(cache=True)
def _decode(
    now: NDArray[np.uint8], before: NDArray[np.uint8], bits: NDArray[np.uint16], data: NDArray[np.uint8]
) -> bool:
    state = start_decoder(data)
    same = 1
    for i in range(len(now)):
        same = decode_bit(state, data, bits, 256 + same)
        if same == 1:
            now[i] = before[i] if i < len(before) else np.uint8(0)
        else:
            node = 1
            for _ in range(8):
                node = node * 2 + decode_bit(state, data, bits, node)
            now[i] = node & 255
        if state[3] != 0:
            return False
    return True


def encode_bytes(now: bytes, before: bytearray) -> bytes:
    """Encode bytes against the ones before, which become these."""
    out = np.empty(16 * len(now) + 64, np.uint8)
    known = np.frombuffer(bytes(before), np.uint8).copy()
    written = _encode(np.frombuffer(now, np.uint8).copy(), known, new_bits(258), out)
    before[:] = now
    return out[:written].tobytes()


def decode_bytes(code: bytes, length: int, before: bytearray) -> bytes:
    """Inverse of :func:`encode_bytes`.

    Raises:
        ArchiveError: the code is damaged.
    """
    now = np.empty(length, np.uint8)
    known = np.frombuffer(bytes(before), np.uint8).copy()
    if not _decode(now, known, new_bits(258), np.frombuffer(bytearray(code), np.uint8)):
        raise ArchiveError("payload does not decode")
    before[:] = now.tobytes()
    return now.tobytes()
