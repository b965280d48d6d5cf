"""Bytes that hardly differ from others: the heads of messages, scan by scan."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from salpcc.stages.entropy.buffer import as_array, require_sound
from salpcc.stages.entropy.range_coder import new_bits
from salpcc.stages.entropy.walks import code_bit, code_tree, failed, finish_coder, start_coder, uncounted


@uncounted
def _walk(
    writing: bool,
    state: NDArray[np.int64],
    now: NDArray[np.uint8],
    before: NDArray[np.uint8],
    bits: NDArray[np.uint16],
    buffer: NDArray[np.uint8],
) -> int:
    same = 1
    for i in range(len(now)):
        expected = np.int64(before[i]) if i < len(before) else 0
        same = code_bit(writing, state, buffer, bits, 256 + same, 1 if now[i] == expected else 0)
        value = expected
        if same == 0:
            value = code_tree(writing, state, buffer, bits, 0, 8, now[i])
        now[i] = value
        if failed(state):
            break
    return finish_coder(writing, state, buffer)


def encode_bytes(now: bytes, before: bytearray) -> bytes:
    """Encode bytes against the ones before, which become these.

    >>> code = encode_bytes(b"frame 18", bytearray(b"frame 17"))
    >>> len(code), decode_bytes(code, 8, bytearray(b"frame 17"))
    (6, b'frame 18')
    """
    out = np.empty(16 * len(now) + 64, np.uint8)
    known = np.frombuffer(bytes(before), np.uint8).copy()
    written = _walk(
        True, start_coder(True, out), np.frombuffer(now, np.uint8).copy(), known, new_bits(258), out
    )
    before[:] = now
    return out[:written].tobytes()


def decode_bytes(code: bytes, length: int, before: bytearray) -> bytes:
    """Inverse of :func:`encode_bytes`.

    Raises:
        ArchiveError: the code is damaged.
    """
    now = np.zeros(length, np.uint8)
    known = np.frombuffer(bytes(before), np.uint8).copy()
    data = as_array(code)
    require_sound(_walk(False, start_coder(False, data), now, known, new_bits(258), data) == 0)
    before[:] = now.tobytes()
    return now.tobytes()
