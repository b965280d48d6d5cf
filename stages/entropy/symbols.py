"""Columns of few small values, losslessly: by value, in the context of the neighbours that others predict from."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from salpcc.stages.entropy.buffer import as_array, room_for, within
from salpcc.stages.entropy.columns import Flags, Values, neighbours, nothing_yet
from salpcc.stages.entropy.range_coder import new_bits
from salpcc.stages.entropy.walks import code_mixed_tree, failed, finish_coder, start_coder, uncounted


def _symbol_models() -> tuple[NDArray[np.uint16], NDArray[np.uint16]]:
    return new_bits(1 << 17), new_bits(1 << 17)


@uncounted
def _walk(
    writing: bool,
    state: NDArray[np.int64],
    last: NDArray[np.int64],
    values: Values,
    void: Flags,
    period: int,
    a: NDArray[np.uint16],
    b: NDArray[np.uint16],
    buffer: NDArray[np.uint8],
) -> int:
    for i in range(len(values)):
        left, _, above, _ = neighbours(values, void, i, period, last)
        kind = 1 if void[i] else 0
        f = (kind * 256 + left) * 256
        g = (kind * 256 + above) * 256
        values[i] = code_mixed_tree(writing, state, buffer, a, f, b, g, 8, values[i])
        if failed(state):
            break
        last[kind, 0] = i
    return finish_coder(writing, state, buffer)


def encode_symbols(values: Values, void: Flags, period: int, to_beat: int) -> bytes | None:
    """Encode values ``(N,)`` of 0 to 255; None where that takes more than the bytes ``to_beat``."""
    out = room_for(16 * len(values) + 4096, to_beat)  # a bit costs 11 at most
    written = int(
        _walk(
            True, start_coder(True, out), nothing_yet(), values.copy(), void, period, *_symbol_models(), out
        )
    )
    return within(out, written, to_beat)


def decode_symbols(void: Flags, period: int, data: bytes) -> tuple[Values, bool]:
    """Inverse of :func:`encode_symbols`."""
    raw = as_array(data)
    values = np.zeros(len(void), np.int64)
    return values, _walk(
        False, start_coder(False, raw), nothing_yet(), values, void, period, *_symbol_models(), raw
    ) == 0
