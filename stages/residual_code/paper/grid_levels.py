"""Levels of a range image by contexts: a mixture of what all guesses say, corrected by what was seen before.

Each guess of :mod:`salpcc.stages.predict.paper.grid_neighbours` is trusted by how far off it was close by; guess and
trust make a logistic distribution, and all of them, with their weighted mean, a mixture. A level is coded as
above or not above the middle, then the class of its distance (1, 2-3, 4-7, ...) in unary, then the distance in its
class. The mixture gives every bit a probability; :mod:`~salpcc.stages.segment.training.scan_mixing` mixes it with those of seven contexts.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.schemas.grid import COLUMNS, ROWS
from salpcc.stages.entropy.mixing import code_given_bit, code_learned_bit, odds
from salpcc.stages.predict.paper.grid_neighbours import BEFORE, GUESSES, guess
from salpcc.stages.residual_code.paper.grid_mixture import below, mix_guesses, share_beyond

_NODES = 64
_CLASSES = 24  # distances below 2 ** 24
_BUCKETS, _SIGNED, _COARSE = 48, 21, 15
_SIZES = np.array(
    [_BUCKETS, _COARSE * _COARSE, ROWS * 3, _SIGNED * 16, _SIGNED * _SIGNED, 144, _SIGNED * _SIGNED]
)
_FIRST = np.concatenate([np.zeros(1, np.int64), np.cumsum(_SIZES)]) * _NODES
CONTEXTS = int(_FIRST[-1])
MIXERS = _NODES * _COARSE
OPINIONS = 2 + len(_SIZES)
_GIVEN = 2

_RATE = 0.004
_FARTHEST = 4000.0  # an error beyond counts as that


def first_weights() -> NDArray[np.float64]:
    """Return the weights of opinions to start from, ``(MIXERS, OPINIONS)``."""
    weights = np.full((MIXERS, OPINIONS), 0.08)
    weights[:, 0], weights[:, 1] = 0.6, 0.0
    return weights


@njit(cache=True, error_model="numpy")
def _bucket(x: float, base: float, most: int) -> int:
    """Number of limits 0.25, 0.25 base, 0.25 base^2, ... that x reaches, at most ``most``."""
    k, limit = 0, 0.25
    while k < most and x >= limit:
        k += 1
        limit *= base
    return k


@njit(cache=True, error_model="numpy")
def _signed(x: float) -> int:
    """0 to 20: sign and logarithm."""
    k = _bucket(abs(x) * 0.5, 2.0, 10)
    return 10 + k if x > 0.0 else 10 - k


@njit(cache=True, error_model="numpy")
def code_levels(
    writing: bool,
    state: NDArray[np.int64],
    buffer: NDArray[np.uint8],
    level: NDArray[np.int32],
    filled: NDArray[np.bool_],
    frame: NDArray[np.float64],
    plane: NDArray[np.float64],
    spreads: NDArray[np.uint8],
    slopes: NDArray[np.float64],
    metres: float,
    chances: NDArray[np.uint16],
    counts: NDArray[np.uint8],
    weights: NDArray[np.float64],
) -> bool:
    """Code the levels of the filled cells, row by row; encoder and decoder are one walk.

    Args:
        level: ``(64, 2000)``; the decoder writes it.
        frame, plane: 1/r predicted, in levels; 0 for none. ``spreads`` 0 to 15 belongs to the frame.
        slopes: ``(64,)``, see :func:`salpcc.stages.predict.paper.grid_neighbours.guess`.
        metres: per level.
        chances, counts, weights: what is learnt through a GOP.

    Returns:
        Whether the levels are possible ones.
    """
    known = np.zeros((ROWS, COLUMNS))
    errors = np.zeros((ROWS, COLUMNS, GUESSES), np.float32)
    off_by = np.zeros((ROWS, COLUMNS))
    guesses, running = np.zeros(GUESSES), np.zeros(GUESSES)
    mean, per, weight = np.zeros(GUESSES + 1), np.zeros(GUESSES + 1), np.zeros(GUESSES + 1)
    opinions = np.zeros(OPINIONS)
    base, places = np.zeros(len(_SIZES), np.int64), np.zeros(len(_SIZES), np.int64)
    before = np.zeros(BEFORE, np.int64)
    up_row, up2_row = -1, -1
    opinions[1] = 0.3
    for row in range(ROWS):
        n_before = 0
        running[:] = 12.0
        last, last2 = 0.0, 0.0
        for column in range(COLUMNS):
            if not filled[row, column]:
                continue
            guess(
                guesses, known, frame, plane, row, column, up_row, up2_row, before, n_before, slopes[row]
            )  # fmt: skip
            spread, apart = mix_guesses(
                guesses, known, errors, running, row, column, up_row, before, n_before, mean, per, weight
            )  # fmt: skip
            middle = mean[GUESSES]
            centre = max(int(np.floor(middle + 0.5)), 1)
            expected = spread + 0.5 * apart
            coarse = _bucket(expected, 2.0, _COARSE - 1)
            of_frame = _signed(1.0 / frame[row, column] - middle) if frame[row, column] > 0.0 else 0
            of_plane = _signed(1.0 / plane[row, column] - middle) if plane[row, column] > 0.0 else 0
            gap = min(column - before[0], 3) - 1 if n_before > 0 else 2
            above = off_by[up_row, column] if up_row >= 0 else 0.0
            base[0] = _bucket(expected, 1.3, _BUCKETS - 1)
            base[1] = coarse * _COARSE + _bucket(abs(last) + 0.5 * abs(last2), 2.0, _COARSE - 1)
            base[2] = row * 3 + gap
            base[3] = of_frame * 16 + min(spreads[row, column], 15)
            base[4] = _signed(last) * _SIGNED + _signed(above)
            base[5] = _bucket(middle * metres * 0.25, 1.7, 11) * 12 + _bucket(apart, 1.6, 11)
            base[6] = of_plane * _SIGNED + of_frame
            for q in range(len(base)):
                base[q] = _FIRST[q] + base[q] * _NODES

            value = np.int64(level[row, column])
            inner = below(centre + 0.5, mean, per, weight)
            outer = 1.0
            opinions[0] = odds(1.0 - inner)
            bit = 1 if value > centre else 0
            places[:] = base
            side = code_learned_bit(
                writing, state, buffer, bit, opinions, _GIVEN, places, chances, counts,
                weights[coarse], _RATE,
            )  # fmt: skip
            sign = 1 if side == 1 else -1
            if side == 0:
                outer = 0.0
            distance = value - centre if side == 1 else centre + 1 - value  # from 1
            size = 0
            while size < _CLASSES:
                edge = centre + 0.5 + sign * ((2 << size) - 1)
                if edge < 0.5:
                    break
                beyond = below(edge, mean, per, weight)
                opinions[0] = odds(share_beyond(inner, outer, beyond))
                node = 1 + side * _CLASSES + min(size, _CLASSES - 1)
                places[:] = base + node
                bit = code_learned_bit(
                    writing, state, buffer, 1 if distance >= 2 << size else 0, opinions, _GIVEN, places,
                    chances, counts, weights[node * _COARSE + coarse], _RATE,
                )  # fmt: skip
                if bit == 0:
                    outer = beyond
                    break
                inner = beyond
                size += 1
            low = 1 << size
            for q in range(size - 1, -1, -1):
                cut = low + (1 << q)
                beyond = below(centre + 0.5 + sign * (cut - 1), mean, per, weight)
                p = share_beyond(inner, outer, beyond)
                bit = 1 if distance >= cut else 0
                if q == size - 1:
                    opinions[0] = odds(p)
                    node = 1 + 2 * _CLASSES + min(size, _NODES - 2 - 2 * _CLASSES)
                    places[:] = base + node
                    bit = code_learned_bit(
                        writing, state, buffer, bit, opinions, _GIVEN, places, chances, counts,
                        weights[node * _COARSE + coarse], _RATE,
                    )  # fmt: skip
                else:
                    bit = code_given_bit(writing, state, buffer, p, bit)
                if bit == 1:
                    low, inner = cut, beyond
                else:
                    outer = beyond
            if not writing:
                value = np.int64(centre + low if side == 1 else centre + 1 - low)
                if value < 1 or value >= 1 << 24:
                    return False
                level[row, column] = value

            r = np.float64(value)
            known[row, column] = 1.0 / r
            last2, last = last, r - middle
            off_by[row, column] = last
            for k in range(GUESSES):
                off = min(abs(mean[k] - r), _FARTHEST)
                errors[row, column, k] = np.float32(off)
                running[k] += 0.13 * (min(off, 200.0) - running[k])
            for m in range(BEFORE - 1, 0, -1):
                before[m] = before[m - 1]
            before[0] = column
            n_before = min(n_before + 1, BEFORE)
        if n_before > 0:
            up2_row, up_row = up_row, row
    return True
