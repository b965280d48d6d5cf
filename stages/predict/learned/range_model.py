"""Predict the range levels of a sweep with the learned mixture; encoder and decoder are one walk.

Stream: the number of levels (3 bytes, little endian), then one interval of 2 ** 24 per return in
firing order, coded by :mod:`salpcc.stages.entropy.range_coder`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.entropy.range_coder import decode_interval, decode_target
from salpcc.stages.lattice.sensor_model import SensorModel
from salpcc.stages.predict.learned.local_plane import LEFT
from salpcc.stages.predict.learned.mixture import (
    BITS,
    PLACES,
    SHARED,
    find_level,
    level_ends,
    output_places,
    set_mixture,
)
from salpcc.stages.predict.learned.network import Layers, Network, forward, pack
from salpcc.stages.predict.learned.previous_features import (
    INPUT_PLACES,
    align_seen,
    gather,
    previous_features,
    see,
    slots_there,
)
from salpcc.stages.predict.learned.previous_features import INPUTS as PREVIOUS_INPUTS
from salpcc.stages.predict.learned.previous_features import PREDICTORS as PREVIOUS_PREDICTORS
from salpcc.stages.predict.learned.previous_sweep import WarpedSweep
from salpcc.stages.predict.learned.range_features import (
    GAPS,
    INPUTS,
    NO_ERROR,
    PREDICTORS,
    SCALE_BITS,
    Laser,
    RingAbove,
    Slots,
    point_features,
    ring_gaps,
    slot_places,
    squashed_errors,
)
from salpcc.stages.predict.learned.walks import COLLECT, DECODE, NO_ROWS, PREDICT, Rows, to_decode, to_predict
from salpcc.stages.predict.ring_rows import PAD, align, close_ring, row_size
from salpcc.stages.predict.sweep_walk import height_ratio, laser_constants, longest_ring, step_feature
from salpcc.stages.predict.vectors import kernel, lane, load, pick, push, spread, store

LEVEL_LIMIT = 1 << 17  # levels of a sweep; a return beyond cannot be coded here
HEADER = 3
_ZERO, _HALF, _ONE = np.float32(0.0), np.float32(0.5), np.float32(1.0)

F32 = NDArray[np.float32]


class _Levels(NamedTuple):
    """The levels ``(M,)`` of a sweep, ``step`` counts each, all below ``number``; ``constants`` of its lasers."""

    level: NDArray[np.int32]
    step: int
    number: int
    constants: F32


class _Ring(NamedTuple):
    """The ring at hand, margins cyclic: ``(size,)`` azimuths, inverse ranges, ``(size, 16)`` squashed errors."""

    azimuth: F32
    inverse: F32
    error: F32


class _Scratch(NamedTuple):
    """Room for one return: inputs, hidden values and sums of the network, predictions, and what the mixture needs."""

    x: NDArray[np.int16]
    hidden: NDArray[np.int16]
    sums: NDArray[np.int32]
    predicted: F32
    mixture: NDArray[np.float64]
    whole: NDArray[np.int32]
    parts: NDArray[np.float64]


@kernel
def _walk_ring(  # type: ignore[no-untyped-def]
    mode, k, lo, m, levels, layers, coded, rows, row, ring, above, second, slots, scratch, before, seen
):
    """Visit the returns of ring k, ``lo`` to ``lo + m``; return how many rows there are now."""
    level, step, number, constants = levels
    azimuth, inverse, errors = ring
    x, h, sums, mu, mixture, whole, parts = scratch
    height2, step_value = np.float32(height_ratio(constants, k)), np.float32(step_feature(step))
    laser = Laser(constants[k, 0], constants[k, 1], height2, step_value)
    middle = np.float32((step - 1) * 0.5)
    shift = layers.shifts[len(layers.shifts) - 1] + SCALE_BITS
    left, error0, signed = spread(_ZERO, 8), spread(NO_ERROR, 16), _ZERO
    components = PREDICTORS + len(SHARED)
    if before is not None:
        components += PREVIOUS_PREDICTORS
        slots_there(k, before.number, seen.there)
    for i in range(m):
        w1, tight, slope_u, slope_v, base, counts = point_features(
            i, azimuth, left, above, second, laser, slots, error0, x
        )
        if before is None:
            counts = pick(counts, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 0, 0, 0, 0, 0)
        else:
            around = gather(i, k, azimuth[PAD + i], before, seen)
            counts = previous_features(
                w1,
                tight,
                slope_u,
                slope_v,
                base,
                laser,
                around,
                signed,
                error0,
                above,
                above.near[i],
                x,
                counts,
            )
        store(mu, 0, counts)
        value = 0
        if mode == COLLECT:
            value = int(level[lo + i])
        else:
            width = layers.first.shape[1] >> 1
            for j in range(0, width, 16):
                store(sums, j, load(layers.tables, k * width + j, 16))
            forward(x, k, layers, h, sums)
            set_mixture(sums, shift, mu, components, mixture, whole)
            if mode == DECODE:
                target = decode_target(coded.state, BITS)
                value, low, high = find_level(mixture, components, target, step, number, whole, parts)
                decode_interval(coded.state, coded.data, low, high - low, BITS)
                level[lo + i] = value
            else:
                value = int(level[lo + i])
                low, high = level_ends(mixture, components, value, step, number, whole, parts)
                coded.intervals[lo + i, 0] = low
                coded.intervals[lo + i, 1] = high - low
        actual = np.float32(value * step) + middle
        w = laser.quotient / max(actual + laser.offset, _ONE)
        inverse[PAD + i] = w
        left = push(left, w)
        error = squashed_errors(actual, counts)
        store(errors, (PAD + i) * 16, error)
        error0 = (error0 + error) * _HALF
        if before is not None:
            signed = actual - lane(counts, PREDICTORS)
        if mode == COLLECT and rows.keep[lo + i]:
            for p in range(rows.inputs.shape[1]):
                rows.inputs[row, p] = x[INPUT_PLACES[p]]
            for p in range(rows.beside.shape[1]):
                rows.beside[row, p] = mu[p] - mu[PREDICTORS - 1]
            rows.target[row] = actual - mu[PREDICTORS - 1]
            row += 1
    return row


@njit(cache=True, error_model="numpy", nogil=True)
def walk(mode, starts, tick, levels, layers, coded, rows, before):  # type: ignore[no-untyped-def]
    """Visit every return in firing order: predict its level, decode it, or collect rows.

    PREDICT fills ``coded.intervals`` with where each level lies in its predicted distribution.
    COLLECT fills one training row per return with ``rows.keep`` set: features, predictions and the actual
    count, both relative to the base, in counts.

    ``before`` is a :class:`WarpedSweep`, or None for a network that does not ask for it.
    """
    longest = longest_ring(starts)
    seen = None if before is None else see(before, longest)
    unused = np.zeros(longest, np.float32)
    size = row_size(starts)
    constants = levels.constants
    azimuth, inverse = np.zeros((3, size), np.float32), np.zeros((3, size), np.float32)
    error = np.zeros((3, size, 16), np.float32)
    count = np.zeros(3, np.int64)
    frame1, frame2 = np.zeros(size, np.float32), np.zeros(size, np.float32)
    index1, index2 = np.full(size, PAD, np.int32), np.full(size, PAD, np.int32)
    value1, value2 = np.zeros(size, np.float32), np.zeros(size, np.float32)
    slots = Slots(np.zeros((LEFT + 1, 32), np.float32), np.zeros((size, GAPS), np.int16))
    width = layers.first.shape[1] >> 1
    scratch = _Scratch(
        np.zeros(layers.first.shape[0] * 2 + 16, np.int16), np.zeros(width, np.int16),
        np.zeros(max(width, layers.last.shape[1] >> 1), np.int32), np.zeros(PLACES, np.float32),
        np.zeros(3 * PLACES), np.zeros(2 * PLACES, np.int32), np.zeros(2 * PLACES),
    )  # fmt: skip
    row = 0
    for k in range(len(starts) - 1):
        r0, r1, r2 = k % 3, (k + 2) % 3, (k + 1) % 3
        lo = starts[k]
        m = starts[k + 1] - lo
        count[r0] = m
        if m == 0:
            continue
        turn, lever = constants[k, 3], constants[k, 4]
        for i in range(m):
            azimuth[r0, PAD + i] = np.float32(tick[lo + i]) + turn
        has1 = k >= 1 and count[r1] > 0
        has2 = k >= 2 and count[r2] > 0 and has1
        if has1:
            arm = constants[k - 1, 4] - lever
            align(azimuth[r1], inverse[r1], count[r1], arm, azimuth[r0], m, frame1, index1, value1)
        if has2:
            arm = constants[k - 2, 4] - lever
            align(azimuth[r2], inverse[r2], count[r2], arm, azimuth[r0], m, frame2, index2, value2)
        if before is not None:
            align_seen(k, before, azimuth[r0], m, lever, seen, unused)
        above = RingAbove(frame1, inverse[r1], error[r1], index1, value1, has1)
        second = RingAbove(frame2, inverse[r2], error[r2], index2, value2, has2)
        slot_places(has1, has2, slots.places)
        ring_gaps(m, azimuth[r0], above, second, slots.gaps)
        ring = _Ring(azimuth[r0], inverse[r0], error[r0])
        row = _walk_ring(
            mode,
            k,
            lo,
            m,
            levels,
            layers,
            coded,
            rows,
            row,
            ring,
            above,
            second,
            slots,
            scratch,
            before,
            seen,
        )
        close_ring(ring.azimuth, ring.inverse, ring.error, m)


def _packed(network: Network, before: WarpedSweep | None) -> Layers:
    """The network's weights in the order of features and components."""
    more = before is not None
    return pack(
        network,
        INPUT_PLACES[: INPUTS + PREVIOUS_INPUTS * more],
        output_places(PREDICTORS + PREVIOUS_PREDICTORS * more),
    )


def count_levels(level: NDArray[np.int32]) -> int:
    """Return how many levels a sweep's range levels ``(M,)`` need; the stream says so first."""
    return int(level.max(initial=0)) + 1


def predict_ranges(
    starts: NDArray[np.int64],
    tick: NDArray[np.int32],
    level: NDArray[np.int32],
    step: int,
    sensor: SensorModel,
    network: Network,
    before: WarpedSweep | None = None,
) -> NDArray[np.uint32]:
    """Predict every level ``(M,)`` from the returns before it.

    Returns:
        ``(M, 2)`` start and width, of ``2 ** BITS``, of the interval that the predicted distribution gives
        to the actual level: what a range coder needs.

    Raises:
        ValueError: a level outside ``[0, LEVEL_LIMIT)``.
    """
    levels = count_levels(level)
    if levels > LEVEL_LIMIT or (len(level) and int(level.min()) < 0):
        raise ValueError(f"range levels must lie in 0..{LEVEL_LIMIT - 1}")
    coded = to_predict(len(level))
    of_sweep = _Levels(level, step, levels, laser_constants(sensor))
    walk(PREDICT, starts, tick, of_sweep, _packed(network, before), coded, NO_ROWS, before)
    return coded.intervals


def decode_ranges(
    starts: NDArray[np.int64],
    tick: NDArray[np.int32],
    step: int,
    sensor: SensorModel,
    network: Network,
    data: NDArray[np.uint8],
    before: WarpedSweep | None = None,
) -> tuple[NDArray[np.int32], bool]:
    """Return the levels ``(M,)`` int32 and whether the data sufficed; inverse of
    :func:`predict_ranges` and the range coder."""
    level = np.zeros(len(tick), np.int32)
    levels = int.from_bytes(data[:HEADER].tobytes(), "little")
    if len(data) < HEADER or not 1 <= levels <= LEVEL_LIMIT:
        return level, False
    coded = to_decode(data[HEADER:])
    of_sweep = _Levels(level, step, levels, laser_constants(sensor))
    walk(DECODE, starts, tick, of_sweep, _packed(network, before), coded, NO_ROWS, before)
    return level, bool(coded.state[3] == 0)


def collect_ranges(
    starts: NDArray[np.int64],
    tick: NDArray[np.int32],
    level: NDArray[np.int32],
    step: int,
    sensor: SensorModel,
    keep: NDArray[np.bool_],
    before: WarpedSweep | None = None,
) -> tuple[NDArray[np.int16], NDArray[np.float32], NDArray[np.float32]]:
    """Return training rows of the returns in ``keep``: features, predictions, target (see :func:`walk`)."""
    n = int(keep.sum())
    more = before is not None
    x = np.zeros((n, INPUTS + PREVIOUS_INPUTS * more), np.int16)
    mu = np.zeros((n, PREDICTORS + PREVIOUS_PREDICTORS * more), np.float32)
    rows = Rows(keep, x, mu, np.zeros(n, np.float32))
    none = _packed(Network.empty(x.shape[1]), before)
    of_sweep = _Levels(level, step, 1, laser_constants(sensor))
    walk(COLLECT, starts, tick, of_sweep, none, to_predict(0), rows, before)
    return rows.inputs, rows.beside, rows.target
