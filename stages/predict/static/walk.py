"""The walk over a sweep of effort ``fast``, of encoder and decoder: levels and intensities side by side.

A value's context waits for the value before, and a processor that waits could do something else. So while the levels of one
ring are walked, the intensities of the ring before are, too: two chains of steps in one loop, in little more time than one.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.entropy.rans import Slots, Words, begin, ended
from salpcc.stages.predict.static import intensities, levels
from salpcc.stages.predict.static.tokens import get
from salpcc.stages.predict.sweep_walk import longest_ring
from salpcc.stages.predict.vectors import kernel, load

Floats = NDArray[np.float64]
Starts = NDArray[np.int64]
Ints = NDArray[np.int32]
Bytes = NDArray[np.uint8]


class Values(NamedTuple):
    """Levels or intensities of a sweep's M returns.

    Attributes:
        value: ``(M,)``, read by the encoder, filled by the decoder.
        context: ``(M,)``; the encoder fills it.
        residual: int32 ``(M,)``, of levels; the encoder fills it.
        slots, words: the tables of symbols, and what the decoder reads.
    """

    value: Ints | Bytes
    context: Bytes | NDArray[np.uint16]
    residual: Ints
    slots: Slots
    words: Words


class Span(NamedTuple):
    """The returns of a ring: where it begins and how many they are."""

    first: int
    n: int


@kernel
def _walk_rings(decoding, tick, ring, span, here, clean, errors, level, x, earlier, above, above2, value, y):  # type: ignore[no-untyped-def]
    """Walk the levels of a ring, and the intensities of the ring before it.

    Args:
        ring, span, here: numbers, returns, and memory to fill, of the ring of levels.
        clean, errors: what :func:`.levels.align` found.
        earlier: the ring of intensities.  above, above2: first returns of the ring above it (which ends there), and of that above it.
        level, value: :class:`Values`.
        x, y: state and position of their decoders.

    Returns:
        x and y afterwards.
    """
    (x, at_x), (y, at_y) = x, y
    of_levels, of_values = levels.begin_ring(clean[0]), intensities.begin_ring()
    j, j2 = above - 1, above2 - 1
    for i in range(max(span.n, earlier.n)):
        if i < earlier.n:
            at = np.uint64(earlier.first + i)
            j = intensities.follow(j, earlier.first, tick, tick[at])
            j2 = intensities.follow(j2, above, tick, tick[at])
            around = intensities.weigh(earlier.first, i, j, j2, above, above2, level.value, value.value)
            context, mean = intensities.guess(of_values, around, i)
            if decoding:
                shade, y, at_y = intensities.get(y, at_y, value.words, context, value.slots)
                value.value[at] = shade
            else:
                shade = np.int64(value.value[at])
                value.context[at] = context
            of_values = intensities.learn(of_values, mean, shade)
        if i < span.n:
            at = np.uint64(span.first + i)
            now, seen = np.int64(tick[at]), clean[np.uint64(i)]
            gap = np.float64(now - tick[np.uint64(span.first + i - 1)]) if i > 0 else 2.0
            guessed = levels.guess(of_levels, gap, seen, load(errors, i * 4, 4), ring)
            if decoding:
                change, x, at_x = get(x, at_x, level.words, guessed.context, level.slots)
                found = min(max(guessed.level + change, 0), levels.MAX_LEVEL)
                level.value[at] = found
            else:
                found = np.int64(level.value[at])
                level.context[at] = guessed.context
                level.residual[at] = found - guessed.level
            of_levels = levels.learn(of_levels, guessed, found, gap, seen, i, now, ring, here)
    return (x, at_x), (y, at_y)


@njit(cache=True, error_model="numpy", nogil=True)
def walk(
    decoding: bool,
    starts: Starts,
    tick: Ints,
    step: int,
    table: Floats,
    level: Values,
    value: Values,
    valued: bool,
) -> bool:
    """Find the contexts of a sweep's levels and intensities, and decode them on the way if asked to.

    Args:
        starts: first return of each ring, ``(L + 1,)``.  tick: ``(M,)``.  table: see :func:`.levels.laser_table`.
        value: intensities in hundredths, if ``valued``; else levels alone are walked.

    Returns:
        whether the words were those of an encoder.
    """
    size = longest_ring(starts) + 1
    memory = np.zeros((2, size, levels.COLUMNS))
    clean = np.zeros(size)
    errors = levels.errors_without(size)
    rings = np.flatnonzero(np.diff(starts))
    x, y = (1, 0), (1, 0)
    if decoding:
        x, y = begin(level.words), begin(value.words) if valued else y
        if x[0] == 0 or y[0] == 0:
            return False
    before = above = above2 = 0  # first returns of the three rings before
    for k in range(len(rings) + 1):
        laser = rings[min(k, len(rings) - 1)] if len(rings) else 0
        ring = levels.ring_of(table, laser, step)
        first = starts[laser] if k < len(rings) else len(tick)
        span = Span(first, starts[laser + 1] - first if k < len(rings) else 0)
        earlier = Span(before, first - before if valued else 0)
        here, there = memory[k % 2], memory[1 - k % 2]
        if first > before:
            levels.align(tick, first, span.n, ring, there, first - before, clean, errors)
        x, y = _walk_rings(
            decoding, tick, ring, span, here, clean, errors, level, x, earlier, above, above2, value, y
        )
        before, above, above2 = first, before, above
    if not decoding:
        return True
    return ended(x[0], x[1], level.words) and (not valued or ended(y[0], y[1], value.words))
