"""Levels and intensities of effort ``fast`` to bytes and back: the walks, and the coder with the tables they choose."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.entropy.rans import LOWEST, Words, finish, push
from salpcc.stages.lattice.sensor_model import SensorModel
from salpcc.stages.predict.static.count_tables import StaticTables, table_of
from salpcc.stages.predict.static.intensities import ESCAPE, PAD, VALUES
from salpcc.stages.predict.static.levels import laser_table
from salpcc.stages.predict.static.tokens import put
from salpcc.stages.predict.static.walk import Values, walk
from salpcc.stages.predict.static.waves import waves

Starts = NDArray[np.int64]
Ints = NDArray[np.int32]
Bytes = NDArray[np.uint8]

_NO_WORDS = np.zeros(0, np.uint32)
_NO_SYMBOLS = np.zeros((0, 0), np.uint16)
_NO_BYTES, _NO_SHORTS, _NO_INTS = np.zeros(0, np.uint8), np.zeros(0, np.uint16), np.zeros(0, np.int32)


class Contexts(NamedTuple):
    """Of levels: context uint8 and residual int32 ``(M,)``; of intensities: context uint16 ``(M,)``, or none; and :func:`.waves.waves`'s order of coding."""

    of_levels: Bytes
    residual: Ints
    of_values: NDArray[np.uint16]
    order: Bytes


def _padded(values: Ints | Bytes) -> NDArray[np.float32]:
    """Return values as :class:`.walk.Values` has them."""
    padded = np.zeros(len(values) + 2 * PAD, np.float32)
    padded[PAD:-PAD] = values
    return padded


def contexts(
    starts: Starts, tick: Ints, level: Ints, step: int, sensor: SensorModel, value: Bytes = _NO_BYTES
) -> Contexts:
    """Return the contexts of levels ``(M,)`` and, where they are given, of intensities 0..100 ``(M,)``."""
    order, ends = waves(starts, tick)
    n = len(level)
    found = Contexts(np.empty(n, np.uint8), np.empty(n, np.int32), np.empty(len(value), np.uint16), order)
    levels = Values(_padded(level), found.of_levels, found.residual, _NO_SYMBOLS, _NO_WORDS)
    values = Values(_padded(value), found.of_values, _NO_INTS, _NO_SYMBOLS, _NO_WORDS)
    walk(False, starts, tick, order, ends, step, laser_table(sensor), levels, values, len(value) > 0)
    return found


# Arrays are the callers': counting references to them, a symbol's worth each time, takes longer than the symbol.
_uncounted = njit(cache=True, _nrt=False)


@_uncounted
def _encode_residuals(
    order: Bytes, ends: Starts, context: Bytes, residual: Ints, start: NDArray[np.uint16], words: Words
) -> int:
    x = other = LOWEST
    position = len(words)
    for back in range(len(order)):
        ring = np.uint64(order[len(order) - 1 - back])
        ends[ring] -= 1
        i = np.uint64(ends[ring])
        other, position = put(other, position, words, np.int64(context[i]), np.int64(residual[i]), start)
        x, other = other, x
    return finish(x, other, position, words)


@_uncounted
def _encode_values(
    order: Bytes,
    ends: Starts,
    context: NDArray[np.uint16],
    value: Bytes,
    start: NDArray[np.uint16],
    words: Words,
) -> int:
    x = other = LOWEST
    position = len(words)
    for back in range(len(order)):
        ring = np.uint64(order[len(order) - 1 - back])
        ends[ring] -= 1
        i = np.uint64(ends[ring])
        row = np.uint64(context[i])
        symbol = np.uint64(value[i])
        low = np.int64(start[row, symbol])
        width = np.int64(start[row, symbol + np.uint64(1)]) - low
        bits = 0
        raw = np.int64(0)
        if width == 0:
            low = np.int64(start[row, ESCAPE])
            width = np.int64(start[row, ESCAPE + 1]) - low
            bits = 7
            raw = np.int64(symbol)
        other, position = push(other, position, words, low, width, bits, raw)
        x, other = other, x
    return finish(x, other, position, words)


@njit(cache=True)
def _ends(order: Bytes) -> Starts:
    """Return where the returns of each ring end, ``(256,)``."""
    many = np.zeros(256, np.int64)
    for ring in order:
        many[ring] += 1
    return np.cumsum(many)


def encode_levels(order: Bytes, context: Bytes, residual: Ints, step: int, tables: StaticTables) -> bytes:
    """Encode what :func:`contexts` gave."""
    words, start = np.empty(2 * len(context) + 4, np.uint32), tables.level_symbols[table_of(step)]
    at = _encode_residuals(order, _ends(order), context, residual, start, words)
    return words[at:].astype("<u4", copy=False).tobytes()


def encode_intensities(
    order: Bytes, context: NDArray[np.uint16], value: Bytes, tables: StaticTables
) -> bytes:
    """Encode intensities 0..100 ``(M,)`` in the contexts that :func:`contexts` gave."""
    words = np.empty(len(context) + 4, np.uint32)
    at = _encode_values(order, _ends(order), context, value, tables.intensity_symbols, words)
    return words[at:].astype("<u4", copy=False).tobytes()


def decode(
    starts: Starts,
    tick: Ints,
    step: int,
    sensor: SensorModel,
    tables: StaticTables,
    levels: Bytes,
    intensities: Bytes | None,
) -> tuple[Ints, Bytes, bool]:
    """Decode levels int32 ``(M,)``, intensities uint8 ``(M,)`` (none of None), and whether the data were those of an encoder."""
    n, valued = len(tick), intensities is not None
    data = levels, levels[:0] if intensities is None else intensities
    if any(len(stream) % 4 for stream in data):
        return np.zeros(n, np.int32), np.zeros(n if valued else 0, np.uint8), False
    words = [stream.view("<u4").astype(np.uint32) for stream in data]
    level, value = np.zeros((2, n + 2 * PAD), np.float32)
    symbols = tables.level_symbols[table_of(step)], tables.intensity_symbols
    of_levels = Values(level, _NO_BYTES, _NO_INTS, symbols[0], words[0])
    of_values = Values(value, _NO_SHORTS, _NO_INTS, symbols[1], words[1])
    sound = walk(
        True, starts, tick, *waves(starts, tick), step, laser_table(sensor), of_levels, of_values, valued
    )
    hundredths = value[PAD:-PAD].astype(np.uint8) if valued else np.zeros(0, np.uint8)
    return level[PAD:-PAD].astype(np.int32), hundredths, bool(sound and (hundredths < VALUES).all())
