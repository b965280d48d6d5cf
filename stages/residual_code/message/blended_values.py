"""Columns that look like a picture, such as intensities: each value from those around it, what lies as far away counting most.

Around a point of an organised cloud lie the points to its left and above; around one of a list of firings, the last of the same laser and of those next
to it in elevation. Their mean, weighted by how alike the distances are, is mended by weights that are learned on the way; how far values were off
nearby tells how far this one may be. A *guide*, another column that was told before, such as reflectivities, tells what points of its value had so far,
times their squared distance: one value more. Decoders repeat all of it: only ``+ - * /`` on float64 in a fixed order.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.entropy.buffer import ENDLESS, as_array, room_for, within
from salpcc.stages.entropy.half_octaves import half_octaves
from salpcc.stages.entropy.range_coder import finish_encoder, new_bits, start_decoder, start_encoder
from salpcc.stages.entropy.residual_bits import PER_CONTEXT, code_number
from salpcc.stages.lists.aimed.aimed_layers import GIVEN, GONE
from salpcc.stages.residual_code.message.learned_values import (
    AROUND,
    ValueWalk,
    code_learned_value,
    note_value,
)

_ALIKE = 0.008  # of the distance; what differs less counts alike
_RATE = 0.004  # of learning
_GUIDED = 2000.0  # what a value by the guide counts
_KEYS, _SLOWEST = 4096, 1.0 / 32.0  # of guides; what a new value counts at least
_BUCKETS, _NARROWEST = 48, 0.25  # of spreads; up to where the first is
_LARGEST = float(1 << 36)
_CLASSES = _BUCKETS // 2
MOST = 1 << 32  # magnitude of a value

I64 = NDArray[np.int64]
F64 = NDArray[np.float64]
Flags = NDArray[np.bool_]


class _Room(NamedTuple):
    """What a walk over values ``(N,)`` knows of those behind it.

    Attributes:
        recent: of each laser, the last point and the one before ``(L, 2)``.
        near, off, weight: what lies around a point, by how much its values are off their mean, and what that is worth ``(AROUND,)``.
        lit, times, stray: of guides ``(KEYS,)`` value, how often, how far off.
        missed: how far off values were ``(N,)``.
    """

    recent: I64
    near: I64
    off: F64
    weight: F64
    lit: F64
    times: F64
    stray: F64
    missed: F64


def _new_room(n: int, lasers: int) -> _Room:
    of_keys = (np.zeros(_KEYS), np.zeros(_KEYS), np.zeros(_KEYS))
    return _Room(
        np.full((lasers, 2), -1),
        np.full(AROUND, -1),
        np.zeros(AROUND),
        np.zeros(AROUND),
        *of_keys,
        np.zeros(n),
    )


@njit(cache=True, _nrt=False)
def _code(  # type: ignore[no-untyped-def]
    writing, state, data, values, void, ranges, width, laser, above, below, guide, role, models, room, learned
):
    """Write or read values ``(N,)``; ``width`` of an organised cloud, or 0: by ``laser``, whose neighbours are ``above`` and ``below``; ``guide``: ``(N,)``, or empty; ``role``: values that are GIVEN are known, those GONE nobody's; ``learned``: of efforts above ``fast``, or None."""
    of_spread, of_value, of_void = models
    n = len(void)
    recent, near, off, weight, lit, times, stray, missed = room
    before, empty = -1, np.int64(0)
    for i in range(n):
        if role[i] == GONE or (void[i] and role[i] == GIVEN):
            continue
        if void[i]:
            empty += code_number(writing, state, data, of_void, 0, of_void, 0, values[i] - empty)
            if not writing:
                if state[3] != 0:
                    return
                values[i] = empty
            continue
        for j in range(AROUND):
            near[j] = -1
        if width > 0:
            column = i % width
            if column > 0:
                near[0] = i - 1
            if column > 1:
                near[1] = i - 2
            if i >= width:
                near[2] = i - width
                if column > 0:
                    near[3] = i - width - 1
                if column < width - 1:
                    near[4] = i - width + 1
            if i >= 2 * width:
                near[5] = i - 2 * width
            for j in range(AROUND):
                if near[j] >= 0 and void[near[j]]:
                    near[j] = -1
        else:
            k = laser[i]
            near[0], near[1] = recent[k, 0], recent[k, 1]
            if above[k] >= 0:
                near[2], near[3] = recent[above[k], 0], recent[above[k], 1]
            if below[k] >= 0:
                near[4] = recent[below[k], 0]
            near[5] = before
        total = mean = miss = 0.0
        per = 1.0 / ranges[i]
        for j in range(AROUND):
            if near[j] < 0:
                continue
            apart = abs(ranges[near[j]] - ranges[i]) * per + _ALIKE
            alike = (1.0 if j in (0, 2) else 0.5) / (apart * apart * (1.0 + missed[near[j]]))
            if learned is not None:
                learned.apart[j], learned.alike[j] = apart, alike
            total += alike
            mean += alike * values[near[j]]
            miss += alike * missed[near[j]]
        key, guided, square = 0, 0.0, ranges[i] * ranges[i]
        if len(guide) > 0:
            key = guide[i] & (_KEYS - 1)
            guided = lit[key] * per * per
            if times[key] > 0.0:
                alike = _GUIDED / (1.0 + stray[key])
                if learned is not None:
                    learned.alike[AROUND - 1] = alike
                total += alike
                mean += alike * guided
                miss += alike * stray[key]
        if total == 0.0 and before >= 0:
            total, mean, miss = 1.0, float(values[before]), missed[before]
        if total > 0.0:
            mean, miss = mean / total, miss / total
        expected, power, rough = mean, 1.0, 0.0
        for j in range(AROUND):
            off[j] = values[near[j]] - mean if near[j] >= 0 else 0.0
            if j == AROUND - 1 and times[key] > 0.0:
                off[j] = guided - mean
            expected += weight[j] * off[j]
            power += off[j] * off[j]
            rough += abs(off[j])
        expected = min(max(expected, -_LARGEST), _LARGEST)
        whole = np.int64(np.floor(expected + 0.5))
        spread = half_octaves(miss + 0.15 * rough, _NARROWEST, _BUCKETS - 1)
        about = half_octaves(abs(expected), _NARROWEST, _BUCKETS - 1)
        if role[i] == GIVEN:
            if learned is not None:
                note_value(learned, i, values[i])
        elif learned is not None:
            values[i] = code_learned_value(
                writing, state, data, learned, i, 0 if width > 0 else laser[i], near, off,
                stray[key] if times[key] > 0.0 else -1.0, mean, expected, miss + 0.15 * rough, values, missed, ranges, values[i],
            )  # fmt: skip
        else:
            number = code_number(
                writing, state, data, of_spread, spread, of_value, about * _CLASSES + spread // 2, values[i] - whole if writing else 0
            )  # fmt: skip
            if not writing:
                values[i] = whole + number
        if state[3] != 0:
            return
        error = min(max(values[i] - expected, -_LARGEST), _LARGEST)
        missed[i] = abs(error)
        if len(guide) > 0:
            gain = max(1.0 / (times[key] + 1.0), _SLOWEST)
            if times[key] > 0.0:
                stray[key] += gain * (abs(values[i] - guided) - stray[key])
            lit[key] += gain * (values[i] * square - lit[key])
            times[key] += 1.0
        learning = _RATE * error / power
        for j in range(AROUND):
            weight[j] = min(max(weight[j] + learning * off[j], -2.0), 2.0)
        before = i
        if width == 0:
            recent[laser[i], 1] = recent[laser[i], 0]
            recent[laser[i], 0] = i


Around = tuple[
    Flags, F64, int, I64, I64, I64, I64, NDArray[np.uint8]
]  # void, ranges, width, laser, above, below, guide, role


def encode_blended(
    values: I64, around: Around, learned: ValueWalk | None = None, to_beat: int = ENDLESS
) -> bytes | None:
    """Encode values ``(N,)`` of a magnitude below MOST; None where that takes more than the bytes ``to_beat``. ``learned``: of such columns before, for efforts above ``fast``."""
    out = room_for(16 * len(values) + 4096, to_beat)
    state = start_encoder()
    _code(True, state, out, values, *around, _models(), _new_room(len(values), len(around[4])), learned)
    return within(out, int(finish_encoder(state, out)), to_beat)


def decode_blended(
    around: Around, data: bytes, learned: ValueWalk | None = None, given: I64 | None = None
) -> tuple[I64, bool]:
    """Inverse of :func:`encode_blended`: the values, and whether the data made sense; ``given``: those that are known ``(N,)``."""
    raw = as_array(data)
    values = np.zeros(len(around[0]), np.int64) if given is None else given.copy()
    state = start_decoder(raw)
    _code(False, state, raw, values, *around, _models(), _new_room(len(values), len(around[4])), learned)
    return values, bool(state[3] == 0)


def _models() -> tuple[NDArray[np.uint16], ...]:
    return (
        new_bits(_BUCKETS * PER_CONTEXT),
        new_bits(_BUCKETS * _CLASSES * PER_CONTEXT),
        new_bits(PER_CONTEXT),
    )
