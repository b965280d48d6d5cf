"""Fields of an organised cloud that follow from the column in which a row was measured, such as times.

The rows of some sensors are shifted against one another, so that columns point the same way. What was measured together lies at
``(column + shift[row]) mod width``; a value is told from the last one there, of the same kind (void or not).
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.entropy.buffer import as_array, room_for, within
from salpcc.stages.entropy.range_coder import finish_encoder, new_bits, start_decoder, start_encoder
from salpcc.stages.entropy.residual_bits import PER_CONTEXT, code_number, size_of
from salpcc.stages.lists.aimed.aimed_layers import GONE, OWN

_LARGEST = 1 << 39
_SIZES = 12  # told apart
_LOOKED_AT = 64  # columns
_HEADS = 4096

I64 = NDArray[np.int64]
U8 = NDArray[np.uint8]
Flags = NDArray[np.bool_]


@njit(cache=True)
def find_shifts(values: I64, void: Flags, width: int, role: U8) -> I64:
    """Return the shift of each row against the first, ``(H,)``: the one by which most values are those above.

    Where nothing is known, what lies above there goes on.
    """
    values, void = values.copy(), void.copy()
    rows = len(values) // width
    shifts = np.zeros(rows, np.int64)
    step = max(width // _LOOKED_AT, 1)
    same = np.zeros(width, np.int64)  # of each turn from the shift above
    first, after = np.empty(_HEADS, np.int64), np.empty(width, np.int64)  # columns above, chained by value
    for row in range(1, rows):
        above = (row - 1) * width
        same[:] = 0
        for column in range(0, width, step):
            here, there = row * width + column, above + column
            same[0] += not void[here] and not void[there] and values[here] == values[there]
        if same[0] * step <= width * 3 // 4:
            same[0] = 0
            first[:] = -1
            for column in range(width - 1, -1, -1):
                if not void[above + column]:
                    head = values[above + column] & (_HEADS - 1)
                    after[column], first[head] = first[head], column
            for column in range(0, width, step):
                here = row * width + column
                there = -1 if void[here] else first[values[here] & (_HEADS - 1)]
                while there >= 0:
                    same[(there - column) % width] += values[here] == values[above + there]
                    there = after[there]
        best = 0
        for turn in range(width):
            if same[turn] > same[best]:
                best = turn
            if same[turn] * step > width * 3 // 4:
                break
        shifts[row] = (shifts[row - 1] + best) % width
        for column in range(width):
            here, there = row * width + column, above + (column + best) % width
            if role[here] == GONE:
                values[here], void[here] = values[there], void[there]
    return shifts


@njit(cache=True)
def _code(writing, state, data, values, void, role, width, shifts, bits):  # type: ignore[no-untyped-def]
    """Write or read values ``(N,)``; ``role``: those that are GIVEN are known, those GONE nobody's."""
    last = np.zeros((2, width), np.int64)
    seen = np.zeros((2, width), np.bool_)
    left, left_size = np.zeros(2, np.int64), np.zeros(2, np.int64)
    pace = np.zeros(2, np.int64)
    steps = 0  # from the place before
    for i in range(len(void)):
        steps += 1
        if role[i] == GONE:
            continue
        kind = np.int64(void[i])
        at = (i % width + shifts[i // width]) % width
        known = np.int64(seen[kind, at])
        expected = last[kind, at] if known else left[kind] + steps * pace[kind]
        off = values[i] - expected
        if writing and role[i] == OWN and abs(off) >= _LARGEST:
            state[3] = 1
            return
        context = (kind * 2 + known) * _SIZES + min(left_size[kind], _SIZES - 1)
        if role[i] == OWN:
            off = code_number(writing, state, data, bits, context, bits, context, off)
            if state[3] != 0:
                return
            if not writing:
                values[i] = expected + off
        left_size[kind] = (size_of(abs(off)) + 1) // 2
        step = values[i] - left[kind]
        if not known and steps == 1 and abs(step) < _LARGEST // 2:
            pace[kind] = pace[kind] + ((step - pace[kind]) >> 3) if pace[kind] else step
        left[kind] = last[kind, at] = values[i]
        seen[kind, at] = True
        steps = 0


def encode_columns(values: I64, void: Flags, width: int, shifts: I64, to_beat: int, role: U8) -> bytes | None:
    """Encode values ``(N,)``, those that are OWN by ``role``; None where they differ too much, or take more than the bytes ``to_beat``."""
    out = room_for(12 * len(values) + 4096, to_beat)
    state = start_encoder()
    _code(True, state, out, values, void, role, width, shifts, _models())
    return within(out, int(finish_encoder(state, out)), to_beat)


def decode_columns(
    void: Flags, width: int, shifts: I64, data: bytes, role: U8, given: I64
) -> tuple[I64, bool]:
    """Inverse of :func:`encode_columns`: the values, and whether the data made sense; ``given``: those that are known ``(N,)``."""
    raw = as_array(data)
    values, state = given.copy(), start_decoder(raw)
    _code(False, state, raw, values, void, role, width, shifts, _models())
    return values, bool(state[3] == 0)


def _models() -> NDArray[np.uint16]:
    return new_bits(4 * _SIZES * PER_CONTEXT)
