"""Predict the range levels of a sweep with the learned mixture; encoder and decoder are one walk.

Stream: the number of levels (3 bytes, little endian), then one interval of 2 ** 24 per return in
firing order, coded by :mod:`salpcc.stages.residual_code.range_coder`.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.ingest.sensor_model import SensorModel
from salpcc.stages.predict.learned.features import INPUTS, PREDICTORS, note_errors, point_features
from salpcc.stages.predict.learned.local_plane import WORK
from salpcc.stages.predict.learned.mixture import BITS, SHARED, find_level, level_start, set_mixture
from salpcc.stages.predict.learned.network import Network, forward
from salpcc.stages.predict.learned.previous_features import INPUTS as PREVIOUS_INPUTS
from salpcc.stages.predict.learned.previous_features import PREDICTORS as PREVIOUS_PREDICTORS
from salpcc.stages.predict.learned.previous_features import SLOTS, gather, previous_features
from salpcc.stages.predict.learned.previous_sweep import WarpedSweep, given
from salpcc.stages.predict.learned.ring_rows import PAD, align, close_ring
from salpcc.stages.predict.learned.sweep_walk import height_ratio, laser_constants, longest_ring, step_feature
from salpcc.stages.residual_code.range_coder import (
    decode_interval,
    decode_target,
    start_decoder,
)

LEVEL_LIMIT = 1 << 17  # levels of a sweep; a return beyond cannot be coded here
HEADER = 3
_NO_KEEP = np.zeros(0, np.bool_)
_NO_ROWS = (np.zeros((0, 0), np.int16), np.zeros((0, 0), np.float32), np.zeros(0, np.float32))
PREDICT, DECODE, COLLECT = 0, 1, 2
_NO_INTERVALS = np.zeros((0, 2), np.uint32)


@njit(cache=True, error_model="numpy")
def walk(  # type: ignore[no-untyped-def]
    mode, starts, tick, level, step, levels, constants,
    first, tables, hidden, hidden_bias, last, last_bias, scales, intervals, state, data,
    keep, rows_x, rows_mu, rows_y, before, cones,
):  # fmt: skip
    """Visit every return in firing order: predict ``level``, decode it, or collect rows.

    PREDICT fills ``intervals`` with where each level lies in its predicted distribution.
    COLLECT fills one training row per return with ``keep`` set: features, predictions and the actual
    count, both relative to the base, in counts. Returns the number of rows.

    ``before`` are the arrays of a :class:`WarpedSweep`, with ``cones`` of :func:`previous_sweep.cones`, or
    both None for a network that does not ask for them.
    """
    inputs, predictors = INPUTS, PREDICTORS
    if before is not None:
        inputs, predictors = INPUTS + PREVIOUS_INPUTS, PREDICTORS + PREVIOUS_PREDICTORS
        number, rows_azimuth, rows_inverse, rows_height, rows_intensity = before
        width = rows_azimuth.shape[1]
        frames = np.zeros((3, width), np.float32)
        indices = np.zeros((3, longest_ring(starts)), np.int32)
        unused = np.zeros(longest_ring(starts), np.float32)
        slot, values = np.zeros((4, SLOTS), np.float32), np.zeros(SLOTS, np.float32)
        signed = np.zeros(1, np.float32)
    size = longest_ring(starts) + 2 * PAD
    azimuth = np.zeros((3, size), np.float32)
    inverse = np.zeros((3, size), np.float32)
    error = np.zeros((3, size, predictors), np.float32)
    count = np.zeros(3, np.int64)
    frame1, frame2 = np.zeros(size, np.float32), np.zeros(size, np.float32)
    index1, index2 = np.zeros(size, np.int32), np.zeros(size, np.int32)
    value1, value2 = np.zeros(size, np.float32), np.zeros(size, np.float32)
    error0 = np.zeros(predictors, np.float32)
    work = np.zeros(WORK, np.float32)
    x = np.zeros(inputs, np.float32)
    mu = np.zeros(predictors, np.float32)
    h, acc = np.zeros(first.shape[1], np.float32), np.zeros(first.shape[1], np.float32)
    out = np.zeros(last.shape[1], np.float32)
    mix = np.zeros((3, predictors + len(SHARED)))
    step_value = np.float32(step_feature(step))
    middle = np.float32((step - 1) * 0.5)
    rows = 0
    for k in range(len(starts) - 1):
        r0, r1, r2 = k % 3, (k + 2) % 3, (k + 1) % 3
        lo = starts[k]
        m = starts[k + 1] - lo
        count[r0] = m
        if m == 0:
            continue
        places, here, errors = azimuth[r0], inverse[r0], error[r0]
        above, errors1, second = inverse[r1], error[r1], inverse[r2]
        quotient, offset, turn, lever = constants[k, 0], constants[k, 1], constants[k, 3], constants[k, 4]
        for i in range(m):
            places[PAD + i] = np.float32(tick[lo + i]) + turn
        has1 = k >= 1 and count[r1] > 0
        has2 = k >= 2 and count[r2] > 0 and has1
        if has1:
            arm = constants[k - 1, 4] - lever
            align(azimuth[r1], above, count[r1], arm, places, m, frame1, index1, value1)
        if has2:
            arm = constants[k - 2, 4] - lever
            align(azimuth[r2], second, count[r2], arm, places, m, frame2, index2, value2)
        height2 = np.float32(height_ratio(constants, k))
        error0[:] = np.float32(1.5)
        if before is not None:
            signed[0] = np.float32(0.0)
            for r in range(max(k - 1, 0), min(k + 2, len(number))):
                if number[r] > 0:
                    align(
                        rows_azimuth[r], rows_inverse[r], number[r], -lever, places, m,
                        frames[r - k + 1], indices[r - k + 1], unused,
                    )  # fmt: skip
        for i in range(m):
            w1, tight, slope_u, slope_v, base = point_features(
                i, m, places, here, frame1, above, errors1, index1, value1, has1,
                frame2, second, index2, value2, has2, height2, quotient, offset, step_value,
                error0, work, x, mu,
            )  # fmt: skip
            if before is not None:
                gather(
                    i, k, places[PAD + i], frames, indices, number, rows_inverse, rows_height, rows_intensity,
                    cones[k, 0], cones[k, 1], cones[k, 2], slot, values,
                )  # fmt: skip
                previous_features(
                    w1, tight, slope_u, slope_v, base, quotient, offset, slot, signed, error0, errors1,
                    index1[i], has1, x, mu,
                )  # fmt: skip
            value = 0
            if mode == COLLECT:
                value = int(level[lo + i])
            else:
                for j in range(len(acc)):
                    acc[j] = tables[0, k, j]
                forward(x, k, first, hidden, hidden_bias, last, last_bias, scales, h, acc, out)
                n = set_mixture(out, mu, mix)
                if mode == DECODE:
                    value, low, high = find_level(mix, n, decode_target(state, BITS), step, levels)
                    decode_interval(state, data, low, high - low, BITS)
                    level[lo + i] = value
                else:
                    value = int(level[lo + i])
                    low = level_start(mix, n, value, step, levels)
                    high = level_start(mix, n, value + 1, step, levels)
                    intervals[lo + i, 0] = low
                    intervals[lo + i, 1] = high - low
            actual = np.float32(value * step) + middle
            here[PAD + i] = quotient / max(actual + offset, np.float32(1.0))
            note_errors(actual, mu, error0, errors, PAD + i)
            if before is not None:
                signed[0] = actual - mu[PREDICTORS]
            if mode == COLLECT and keep[lo + i]:
                for p in range(inputs):
                    rows_x[rows, p] = np.int16(x[p])
                for p in range(predictors):
                    rows_mu[rows, p] = mu[p] - mu[PREDICTORS - 1]
                rows_y[rows] = actual - mu[PREDICTORS - 1]
                rows += 1
        close_ring(places, here, errors, m)
    return rows


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
    intervals = np.zeros((len(level), 2), np.uint32)
    unread = np.zeros(1, np.uint8)
    walk(
        PREDICT, starts, tick, level, step, levels, laser_constants(sensor), *network.arrays(), intervals,
        start_decoder(unread), unread, _NO_KEEP, *_NO_ROWS, *given(before, sensor),
    )  # fmt: skip
    return intervals


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
    body = np.ascontiguousarray(data[HEADER:])
    state = start_decoder(body)
    walk(
        DECODE, starts, tick, level, step, levels, laser_constants(sensor), *network.arrays(), _NO_INTERVALS, state,
        body, _NO_KEEP, *_NO_ROWS, *given(before, sensor),
    )  # fmt: skip
    return level, bool(state[3] == 0)


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
    y = np.zeros(n, np.float32)
    none = Network.empty(INPUTS, 4)
    walk(
        COLLECT, starts, tick, level, step, 1, laser_constants(sensor), *none.arrays(), _NO_INTERVALS,
        start_decoder(np.zeros(1, np.uint8)), np.zeros(1, np.uint8), keep, x, mu, y, *given(before, sensor),
    )  # fmt: skip
    return x, mu, y
