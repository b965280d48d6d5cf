"""Predict the intensities (0..100) of a sweep whose ranges are known; encoder and decoder are one walk.

Stream: one interval of 2 ** 24 per return in firing order. The network's 101 logits become integer
frequencies; their running sums, scaled to 2 ** 24, are the intervals.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.ingest.sensor_model import SensorModel
from salpcc.stages.predict.learned.intensity_features import INPUTS, SLOTS, intensity_features
from salpcc.stages.predict.learned.network import Network, forward
from salpcc.stages.predict.learned.previous_features import INTENSITY_INPUTS, gather, previous_intensity
from salpcc.stages.predict.learned.previous_features import SLOTS as SEEN
from salpcc.stages.predict.learned.previous_sweep import WarpedSweep, given
from salpcc.stages.predict.learned.ring_rows import PAD, align, place_rings
from salpcc.stages.predict.learned.sweep_walk import laser_constants
from salpcc.stages.predict.learned.value_intervals import (
    BITS,
    OUTPUTS,
    VALUES,
    find_value,
    frequencies,
    value_start,
)
from salpcc.stages.residual_code.range_coder import (
    decode_interval,
    decode_target,
    start_decoder,
)

PREDICT, DECODE, COLLECT = 0, 1, 2
_NO_INTERVALS = np.zeros((0, 2), np.uint32)
_NO_KEEP = np.zeros(0, np.bool_)
_NO_ROWS = (np.zeros((0, 0), np.int16), np.zeros((0, 0), np.uint8))


@njit(cache=True, error_model="numpy")
def walk(  # type: ignore[no-untyped-def]
    mode, starts, azimuth, inverse, intensity, constants,
    first, tables, hidden, hidden_bias, last, last_bias, scales, intervals, state, data,
    keep, rows_x, rows_side, before, cones,
):  # fmt: skip
    """Predict ``intensity`` (fills ``intervals``), decode it, or collect rows of the returns in ``keep``."""
    n_rings = len(starts) - 1
    size = azimuth.shape[1]
    inputs = INPUTS
    if before is not None:
        inputs = INPUTS + INTENSITY_INPUTS
        number, rows_azimuth, rows_inverse, rows_height, rows_intensity = before
        frames = np.zeros((3, rows_azimuth.shape[1]), np.float32)
        indices = np.zeros((3, size), np.int32)
        slot, seen = np.zeros((4, SEEN), np.float32), np.zeros(SEEN, np.float32)
    values = np.zeros((3, size), np.float32)
    near, places_of = np.zeros((3, size), np.float32), np.zeros((3, size), np.int32)
    count = np.zeros(3, np.int64)
    unused = np.zeros(size, np.float32)
    x = np.zeros(inputs, np.float32)
    work = np.zeros(3 * SLOTS, np.float32)
    width = first.shape[1]
    h, acc, out = (
        np.zeros(width, np.float32),
        np.zeros(width, np.float32),
        np.zeros(last.shape[1], np.float32),
    )
    freq = np.zeros(VALUES, np.int32)
    rows = 0
    for k in range(n_rings):
        lo = starts[k]
        m = starts[k + 1] - lo
        if m == 0:
            continue
        up, second, down = max(k - 1, 0), max(k - 2, 0), min(k + 1, n_rings - 1)
        count[0] = starts[k] - starts[up]
        count[1] = starts[up] - starts[second]
        count[2] = starts[down + 1] - starts[down] if down > k else 0
        for r, ring in enumerate((up, second, down)):
            if count[r] > 0:
                align(
                    azimuth[ring], inverse[ring], count[r], constants[ring, 4] - constants[k, 4],
                    azimuth[k], m, near[r], places_of[r], unused,
                )  # fmt: skip
        current, upper, other = values[k % 3], values[(k + 2) % 3], values[(k + 1) % 3]
        q = constants[k, 0]
        activity = np.float32(3.0)
        here, above1, above2, below = inverse[k], inverse[up], inverse[second], inverse[down]
        places = azimuth[k]
        if before is not None:
            change, bias = np.float32(3.0), np.float32(0.0)
            for r in range(max(k - 1, 0), min(k + 2, n_rings)):
                if number[r] > 0:
                    align(
                        rows_azimuth[r], rows_inverse[r], number[r], -constants[k, 4], places, m,
                        frames[r - k + 1], indices[r - k + 1], unused,
                    )  # fmt: skip
        for i in range(m):
            left, above, mean = intensity_features(
                i, m, places, here, current, count[0] > 0, near[0], above1, upper, places_of[0],
                count[1] > 0, above2, other, places_of[1], count[2] > 0, below, places_of[2], q, activity, x, work,
            )  # fmt: skip
            if before is not None:
                gather(
                    i, k, places[PAD + i], frames, indices, number, rows_inverse, rows_height, rows_intensity,
                    cones[k, 0], cones[k, 1], cones[k, 2], slot, seen,
                )  # fmt: skip
                once, expected = previous_intensity(here[PAD + i], q, slot, seen, change, bias, x)
            if mode == COLLECT:
                value = int(intensity[lo + i])
                if keep[lo + i]:
                    for p in range(inputs):
                        rows_x[rows, p] = np.int16(x[p])
                    rows_side[rows, 0] = left
                    rows_side[rows, 1] = above
                    if before is not None:
                        rows_side[rows, 2] = once
                    rows += 1
            else:
                for j in range(width):
                    acc[j] = (tables[0, k, j] + tables[1, left, j]) + tables[2, above, j]
                if before is not None:
                    for j in range(width):
                        acc[j] += tables[3, once, j]
                forward(x, k, first, hidden, hidden_bias, last, last_bias, scales, h, acc, out)
                frequencies(out, freq)
                total = 0
                for v in range(VALUES):
                    total += freq[v]
                if mode == PREDICT:
                    value = int(intensity[lo + i])
                    cum = value_start(freq, value)
                else:
                    value, cum = find_value(freq, total, decode_target(state, BITS))
                low = (cum << BITS) // total
                high = ((cum + freq[value]) << BITS) // total
                if mode == PREDICT:
                    intervals[lo + i, 0] = low
                    intervals[lo + i, 1] = high - low
                else:
                    decode_interval(state, data, low, high - low, BITS)
                    intensity[lo + i] = value
            current[PAD + i] = np.float32(value)
            if before is not None:
                off = np.float32(value) - expected
                change = np.float32(0.75) * change + np.float32(0.25) * abs(off)
                bias = np.float32(0.75) * bias + np.float32(0.25) * off
            activity = np.float32(0.75) * activity + np.float32(0.25) * abs(np.float32(value) - mean)
        for p in range(PAD):
            current[PAD - 1 - p] = current[PAD + m - 1 - p % m]
            current[PAD + m + p] = current[PAD + p % m]
    return rows


def predict_intensity(
    starts: NDArray[np.int64],
    tick: NDArray[np.int32],
    level: NDArray[np.int32],
    step: int,
    intensity: NDArray[np.uint8],
    sensor: SensorModel,
    network: Network,
    before: WarpedSweep | None = None,
) -> NDArray[np.uint32]:
    """Predict intensities ``(M,)`` 0..100 from all ranges and the intensities before.

    Returns:
        ``(M, 2)`` start and width, of ``2 ** BITS``, of the interval of each actual intensity.

    Raises:
        ValueError: an intensity above 100.
    """
    if len(intensity) and int(intensity.max()) >= VALUES:
        raise ValueError("intensities must lie in 0..100")
    constants = laser_constants(sensor)
    azimuth, inverse = place_rings(starts, tick, level, step, constants)
    intervals = np.zeros((len(intensity), 2), np.uint32)
    unread = np.zeros(1, np.uint8)
    walk(
        PREDICT, starts, azimuth, inverse, intensity, constants, *network.arrays(), intervals,
        start_decoder(unread), unread, _NO_KEEP, *_NO_ROWS, *given(before, sensor),
    )  # fmt: skip
    return intervals


def decode_intensity(
    starts: NDArray[np.int64],
    tick: NDArray[np.int32],
    level: NDArray[np.int32],
    step: int,
    sensor: SensorModel,
    network: Network,
    data: NDArray[np.uint8],
    before: WarpedSweep | None = None,
) -> tuple[NDArray[np.uint8], bool]:
    """Return intensities ``(M,)`` uint8 and whether the data sufficed; inverse of
    :func:`predict_intensity` and the range coder."""
    constants = laser_constants(sensor)
    azimuth, inverse = place_rings(starts, tick, level, step, constants)
    intensity = np.zeros(len(tick), np.uint8)
    body = np.ascontiguousarray(data)
    state = start_decoder(body)
    walk(
        DECODE, starts, azimuth, inverse, intensity, constants, *network.arrays(), _NO_INTERVALS, state,
        body, _NO_KEEP, *_NO_ROWS, *given(before, sensor),
    )  # fmt: skip
    return intensity, bool(state[3] == 0)


def collect_intensity(
    starts: NDArray[np.int64],
    tick: NDArray[np.int32],
    level: NDArray[np.int32],
    step: int,
    intensity: NDArray[np.uint8],
    sensor: SensorModel,
    keep: NDArray[np.bool_],
    before: WarpedSweep | None = None,
) -> tuple[NDArray[np.int16], NDArray[np.uint8]]:
    """Return features and the nearest intensities (left, above) of the returns in ``keep``."""
    n = int(keep.sum())
    more = before is not None
    x, sides = np.zeros((n, INPUTS + INTENSITY_INPUTS * more), np.int16), np.zeros((n, 2 + more), np.uint8)
    constants = laser_constants(sensor)
    azimuth, inverse = place_rings(starts, tick, level, step, constants)
    none = Network.empty(INPUTS, OUTPUTS)
    walk(
        COLLECT, starts, azimuth, inverse, intensity, constants, *none.arrays(), _NO_INTERVALS,
        start_decoder(np.zeros(1, np.uint8)), np.zeros(1, np.uint8), keep, x, sides, *given(before, sensor),
    )  # fmt: skip
    return x, sides
