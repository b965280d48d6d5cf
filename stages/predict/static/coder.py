"""Levels and intensities of effort ``fast`` to bytes and back: the walks, and the coder with the tables they choose."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.entropy.rans import LOWEST, Words, finish, push
from salpcc.stages.lattice.sensor_model import SensorModel
from salpcc.stages.predict.static.count_tables import StaticTables, table_of
from salpcc.stages.predict.static.intensities import ESCAPE, walk_intensities
from salpcc.stages.predict.static.levels import laser_table, walk_levels
from salpcc.stages.predict.static.tokens import put

Starts = NDArray[np.int64]
Ints = NDArray[np.int32]
Bytes = NDArray[np.uint8]

_NO_WORDS = np.zeros(0, np.uint32)
_NO_STARTS = np.zeros((0, 0), np.uint16)
_NO_GUIDE = np.zeros((0, 0), np.uint8)


def level_contexts(
    starts: Starts, tick: Ints, level: Ints, step: int, sensor: SensorModel
) -> tuple[Bytes, Ints]:
    """Return context uint8 and residual int32 of each level ``(M,)``."""
    context, residual = np.empty(len(level), np.uint8), np.empty(len(level), np.int32)
    walk_levels(
        False, starts, tick, level, step, laser_table(sensor), context, residual,
        _NO_STARTS, _NO_GUIDE, _NO_WORDS,
    )  # fmt: skip
    return context, residual


def intensity_contexts(starts: Starts, tick: Ints, level: Ints, value: Bytes) -> NDArray[np.uint16]:
    """Return the context uint16 of each intensity 0..100 ``(M,)``."""
    context = np.empty(len(value), np.uint16)
    walk_intensities(False, starts, tick, level, value, context, _NO_STARTS, _NO_GUIDE, _NO_WORDS)
    return context


# Arrays are the callers': counting references to them, a symbol's worth each time, takes longer than the symbol.
_uncounted = njit(cache=True, _nrt=False)


@_uncounted
def _encode_residuals(context: Bytes, residual: Ints, start: NDArray[np.uint16], words: Words) -> int:
    x = LOWEST
    position = len(words)
    for back in range(len(context)):
        i = len(context) - 1 - back
        x, position = put(x, position, words, np.int64(context[i]), np.int64(residual[i]), start)
    return finish(x, position, words)


@_uncounted
def _encode_values(context: NDArray[np.uint16], value: Bytes, start: NDArray[np.uint16], words: Words) -> int:
    x = LOWEST
    position = len(words)
    for back in range(len(context)):
        i = np.uint64(len(context) - 1 - back)
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
        x, position = push(x, position, words, low, width, bits, raw)
    return finish(x, position, words)


def encode_levels(context: Bytes, residual: Ints, step: int, tables: StaticTables) -> bytes:
    """Encode what :func:`level_contexts` gave."""
    words = np.empty(2 * len(context) + 2, np.uint32)
    at = _encode_residuals(context, residual, tables.level_symbols[table_of(step)].start, words)
    return words[at:].astype("<u4", copy=False).tobytes()


def encode_intensities(context: NDArray[np.uint16], value: Bytes, tables: StaticTables) -> bytes:
    """Encode intensities 0..100 ``(M,)`` in the contexts that :func:`intensity_contexts` gave."""
    words = np.empty(len(context) + 2, np.uint32)
    at = _encode_values(context, value, tables.intensity_symbols.start, words)
    return words[at:].astype("<u4", copy=False).tobytes()


def _words(data: Bytes) -> Words | None:
    """The words of a stream, None where it holds no whole number of them."""
    return data.view("<u4").astype(np.uint32) if len(data) % 4 == 0 else None


def decode_levels(
    starts: Starts, tick: Ints, step: int, sensor: SensorModel, tables: StaticTables, data: Bytes
) -> tuple[Ints, bool]:
    """Decode levels int32 ``(M,)``, and whether the data were those of an encoder."""
    level = np.zeros(len(tick), np.int32)
    words, symbols = _words(data), tables.level_symbols[table_of(step)]
    if words is None:
        return level, False
    sound = walk_levels(
        True, starts, tick, level, step, laser_table(sensor), np.empty(0, np.uint8), np.empty(0, np.int32),
        symbols.start, symbols.guide, words,
    )  # fmt: skip
    return level, bool(sound)


def decode_intensities(
    starts: Starts, tick: Ints, level: Ints, tables: StaticTables, data: Bytes
) -> tuple[Bytes, bool]:
    """Decode intensities uint8 ``(M,)``, and whether the data were those of an encoder."""
    value = np.zeros(len(tick), np.uint8)
    words, symbols = _words(data), tables.intensity_symbols
    if words is None:
        return value, False
    sound = walk_intensities(
        True, starts, tick, level, value, np.empty(0, np.uint16), symbols.start, symbols.guide, words
    )
    return value, bool(sound)
