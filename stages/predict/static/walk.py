"""The walk over a sweep of effort ``fast``, of encoder and decoder: levels and intensities of all rings, wave after wave (:mod:`.waves`).

The returns of a wave are predicted in vectors, and a processor need not wait for one to begin with the next.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.entropy.rans import Words, begin, ended
from salpcc.stages.predict.static import intensities, levels
from salpcc.stages.predict.static.columns import LANES, Columns, F, cell
from salpcc.stages.predict.static.intensities import PAD
from salpcc.stages.predict.static.symbols import Starts
from salpcc.stages.predict.static.tokens import get
from salpcc.stages.vectors import inline, kernel, prefetch

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
Ints = NDArray[np.int32]
Bytes = NDArray[np.uint8]

_SOON = 6  # rings from now on


class Values(NamedTuple):
    """Levels or intensities of a sweep's M returns.

    Attributes:
        value: ``(PAD + M + PAD,)`` whole numbers, read by the encoder, filled by the decoder.
        context: ``(M,)``; the encoder fills it.
        residual: int32 ``(M,)``, of levels; the encoder fills it.
        symbols, words: where the intervals of symbols begin, and what the decoder reads.
    """

    value: F32
    context: Bytes | NDArray[np.uint16]
    residual: Ints
    symbols: Starts
    words: Words


class Rings(NamedTuple):
    """The R rings that have returns, and how far the walk has come.

    Attributes:
        first, next: their first and their next returns, ``(R,)``.
        seen: what :func:`.levels.see` gave.
        above, above2: the last returns of the two rings above that are not after what was seen last.
        rows: see :func:`.levels.no_rows`.
    """

    first: I64
    next: I64
    seen: I64
    above: I64
    above2: I64
    rows: F32


@njit(cache=True)
def _before_all(first: I64) -> Rings:
    rings = np.arange(len(first))
    above, above2 = first[np.maximum(rings - 1, 0)] - 1, first[np.maximum(rings - 2, 0)] - 1
    return Rings(first, first.copy(), np.full(len(first), -1), above, above2, levels.no_rows(len(first)))


@inline
def _see_levels(rings: Rings, wave: Bytes, tick: Ints, of_levels: Columns) -> None:
    for k in range(len(wave)):
        r, soon = np.int64(wave[np.uint64(k)]), np.uint64(wave[np.uint64(min(k + _SOON, len(wave) - 1))])
        # More than the first cache holds is gone through from wave to wave.
        prefetch(tick, rings.next[soon])
        prefetch(rings.rows, levels.row_above(np.int64(soon), rings.seen[soon] + 1))
        u = np.uint64(r)
        at = rings.next[u]
        of_levels[cell(levels.ACTIVE, r)] = F(1.0)
        of_levels[cell(levels.TICK, r)] = now = F(tick[np.uint64(at)])
        v = np.uint64(r - 1)
        known = rings.next[v] - rings.first[v] if r > 0 else 0
        rings.seen[u] = levels.see(r, now, known, rings.seen[u], of_levels, rings.rows)


@inline
def _see_values(rings: Rings, wave: Bytes, tick: Ints, of_values: Columns, level: F32, value: F32) -> None:
    for ring in wave:
        r = np.int64(ring)
        u = np.uint64(r)
        v, w = np.uint64(r - 1 if r > 0 else 0), np.uint64(r - 2 if r > 1 else 0)
        now = tick[np.uint64(rings.next[u])]
        end = rings.next[v] if r > 0 else 0
        end2 = rings.next[w] if r > 1 else 0
        j = intensities.follow(rings.above[u], end, tick, now)
        j2 = intensities.follow(rings.above2[u], end2, tick, now)
        rings.above[u], rings.above2[u] = j, j2
        intensities.weigh(r, of_values, j, rings.first[v], end, j2, rings.first[w], end2, level, value)


@inline
def _code_levels(decoding, rings, wave, of_levels, level, x):  # type: ignore[no-untyped-def]
    x, other, position = x
    for ring in wave:
        r = np.int64(ring)
        i = rings.next[np.uint64(r)]
        at = np.uint64(i + PAD)
        context, guessed = levels.context_of(of_levels, r), np.int64(of_levels[cell(levels.LEVEL, r)])
        if decoding:
            change, x, position = get(x, position, level.words, context, level.symbols)
            x, other = other, x
            level.value[at] = F(min(max(guessed + change, 0), levels.MAX_LEVEL))
        else:
            level.context[np.uint64(i)] = context
            level.residual[np.uint64(i)] = np.int64(level.value[at]) - guessed
        of_levels[cell(levels.FOUND, r)] = level.value[at]
    return x, other, position


@inline
def _code_values(decoding, rings, wave, of_values, value, x):  # type: ignore[no-untyped-def]
    x, other, position = x
    for ring in wave:
        r = np.int64(ring)
        i = rings.next[np.uint64(r)]
        at = np.uint64(i + PAD)
        context = intensities.context_of(of_values, r)
        if decoding:
            found, x, position = intensities.get(x, position, value.words, context, value.symbols)
            x, other = other, x
            value.value[at] = F(found)
        else:
            value.context[np.uint64(i)] = context
        of_values[cell(intensities.FOUND, r)] = value.value[at]
    return x, other, position


@inline
def _advance(rings: Rings, wave: Bytes, of_levels: Columns) -> None:
    for ring in wave:
        r = np.int64(ring)
        u = np.uint64(r)
        at = rings.next[u]
        levels.leave(r, at - rings.first[u], of_levels, rings.rows)
        rings.next[u] = at + 1
        of_levels[cell(levels.ACTIVE, r)] = F(0.0)


@kernel
def _walk(decoding, rings, order, ends, tick, step, of_levels, of_values, level, value, valued, x, y):  # type: ignore[no-untyped-def]
    done = 0
    for end in ends:
        wave = order[done:end]
        lowest, beyond = np.int64(wave[0]) // LANES * LANES, np.int64(wave[len(wave) - 1]) + 1
        _see_levels(rings, wave, tick, of_levels)
        levels.guess(of_levels, lowest, beyond, F(1.0 / step))
        x = _code_levels(decoding, rings, wave, of_levels, level, x)
        levels.learn(of_levels, lowest, beyond, F(step))
        if valued:
            intensities.place(of_values, of_levels, lowest, beyond)
            _see_values(rings, wave, tick, of_values, level.value, value.value)
            intensities.guess(of_values, lowest, beyond)
            y = _code_values(decoding, rings, wave, of_values, value, y)
            intensities.learn(of_values, of_levels, lowest, beyond)
        _advance(rings, wave, of_levels)
        done = end
    return x, y


@njit(cache=True, error_model="numpy", nogil=True)
def walk(
    decoding: bool,
    starts: I64,
    tick: Ints,
    order: Bytes,
    ends: Ints,
    step: int,
    table: F64,
    level: Values,
    value: Values,
    valued: bool,
) -> bool:
    """Find the contexts of a sweep's levels and intensities, and decode them on the way if asked to.

    Args:
        starts: first return of each ring, ``(L + 1,)``.  tick: ``(M,)``.  order, ends: of :func:`.waves.waves`.  table: see :func:`.levels.laser_table`.
        value: intensities in hundredths, if ``valued``; else levels alone are walked.

    Returns:
        whether the words were those of an encoder.
    """
    x, y = (1, 1, 0), (1, 1, 0)
    if decoding:
        x, y = begin(level.words), begin(value.words) if valued else y
        if x[0] == 0 or y[0] == 0:
            return False
    lasers = np.flatnonzero(np.diff(starts))
    of_levels, of_values = levels.begin(table, lasers, step), intensities.begin()
    rings = _before_all(starts[lasers])
    x, y = _walk(decoding, rings, order, ends, tick, step, of_levels, of_values, level, value, valued, x, y)
    if not decoding:
        return True
    return ended(x, level.words) and (not valued or ended(y, value.words))
