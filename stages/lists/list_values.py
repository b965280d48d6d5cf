"""One float32 a point, such as its intensity: whole numbers of a decimal unit where they are, else float bits.

Stream: one byte, 0 for the bits of :mod:`~salpcc.stages.entropy.integers`, else the position in UNITS plus one; then, of whole numbers
below 2 ** 16, left and up (uint16 each, :mod:`~salpcc.stages.lists.rays.ray_coder`) and the numbers, high byte and low byte, in
the contexts of the left and the upper number.
"""

from __future__ import annotations

import struct

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.entropy.integers import decode_integers, encode_integers, integer_model
from salpcc.stages.entropy.range_coder import finish_encoder, new_bits, start_decoder, start_encoder
from salpcc.stages.entropy.walks import code_mixed_tree
from salpcc.stages.lattice.publish import from_ordered_bits, ordered_bits
from salpcc.stages.lists.rays.ray_coder import Layout

UNITS = (1.0, 100.0, 255.0, 10.0, 1000.0, 256.0, 65535.0)  # numbers in a whole one
_HEAD = struct.Struct("<BHH")
_HIGH, _LOW = 256 * 256, 128 * 8 * 256


@njit(cache=True)
def code_values(
    writing: bool,
    values: NDArray[np.int64],
    left: int,
    up: int,
    models: tuple[NDArray[np.uint16], NDArray[np.uint16], NDArray[np.uint16], NDArray[np.uint16]],
    state: NDArray[np.int64],
    data: NDArray[np.uint8],
) -> None:
    """Write or read whole numbers ``(n,)`` int64 of 0..65535."""
    for i in range(len(values)):
        a = values[i - left] if i >= left else 0
        b = values[i - up] if up > 0 and i >= up else (values[i - 2 * left] if i >= 2 * left else a)
        value = values[i]
        high = code_mixed_tree(writing, state, data, models[0], a & ~255, models[1], b & ~255, 8, value >> 8)
        near = min(max(a - (high << 8), 0), 255)
        other = min(max(b - (high << 8), 0), 255)
        apart = abs(near - other)
        spread = 0
        while spread < 7 and apart >> spread:
            spread += 1
        row = ((near + other) // 4 * 8 + spread) * 256
        low = code_mixed_tree(writing, state, data, models[2], row, models[3], near * 256, 8, value & 255)
        values[i] = high << 8 | low


def _models() -> tuple[NDArray[np.uint16], NDArray[np.uint16], NDArray[np.uint16], NDArray[np.uint16]]:
    return new_bits(_HIGH), new_bits(_HIGH), new_bits(_LOW), new_bits(_HIGH)


def encode_values(values: NDArray[np.float32], layout: Layout, out: NDArray[np.uint8]) -> int:
    """Encode float32 values ``(S,)`` exactly; return the bytes written to ``out``, -1 if full."""
    values = np.ascontiguousarray(values)
    left, up = max(layout[0], 1), layout[1]
    for place, unit in enumerate(UNITS):
        with np.errstate(invalid="ignore"):
            whole = np.rint(np.clip(np.nan_to_num(values.astype(np.float64) * unit), 0, 65535)).astype(
                np.int64
            )
        if ((whole / unit).astype(np.float32).view(np.int32) == values.view(np.int32)).all():
            out[: _HEAD.size] = np.frombuffer(_HEAD.pack(place + 1, left, up), np.uint8)
            state = start_encoder()
            code_values(True, whole, left, up, _models(), state, out[_HEAD.size :])
            written = int(finish_encoder(state, out[_HEAD.size :]))
            return written + _HEAD.size if written >= 0 else -1
    out[0] = 0
    written = encode_floats(values, out[1:])
    return written + 1 if written >= 0 else -1


def decode_values(n: int, data: NDArray[np.uint8]) -> tuple[NDArray[np.float32], bool]:
    """Inverse of :func:`encode_values`; the values and whether the data made sense."""
    if n == 0:
        return np.zeros(0, np.float32), True
    if not len(data) or data[0] == 0:
        values, sound = decode_floats(n, data[1:])
        return values, sound and len(data) > 0
    if len(data) < _HEAD.size or data[0] > len(UNITS):
        return np.zeros(n, np.float32), False
    place, left, up = _HEAD.unpack(data[: _HEAD.size].tobytes())
    if left == 0:
        return np.zeros(n, np.float32), False
    whole = np.zeros(n, np.int64)
    body = np.ascontiguousarray(data[_HEAD.size :])
    state = start_decoder(body)
    code_values(False, whole, left, up, _models(), state, body)
    return (whole / UNITS[place - 1]).astype(np.float32), bool(state[3] == 0)


def encode_floats(values: NDArray[np.float32], out: NDArray[np.uint8]) -> int:
    """Encode float32 values ``(S,)`` exactly; return the bytes written to ``out``, -1 if full."""
    return int(encode_integers(ordered_bits(np.ascontiguousarray(values))[:, None], integer_model(1), out))


def decode_floats(n: int, data: NDArray[np.uint8]) -> tuple[NDArray[np.float32], bool]:
    """Inverse of :func:`encode_floats`."""
    rows, sound = decode_integers(n, 1, integer_model(1), data)
    return from_ordered_bits(np.clip(rows[:, 0], -(1 << 31), (1 << 31) - 1)), bool(sound)
