"""Predict the intensities (0..100) of a sweep whose ranges are known; encoder and decoder are one walk.

Stream: one interval of 2 ** 24 per return in firing order. The network's 101 logits become integer
frequencies; their running sums, scaled to 2 ** 24, are the intervals.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.entropy.range_coder import (
    decode_interval,
    decode_target,
    start_decoder,
)
from salpcc.stages.lattice.sensor_model import SensorModel
from salpcc.stages.predict.learned.intensity_features import (
    GAPS,
    INPUTS,
    LEFT,
    NONE,
    intensity_features,
    ring_gaps,
    slot_places,
)
from salpcc.stages.predict.learned.network import Layers, Network, forward, pack
from salpcc.stages.predict.learned.previous_features import (
    INTENSITY_INPUTS,
    INTENSITY_PLACES,
    gather,
    previous_intensity,
    slots_there,
)
from salpcc.stages.predict.learned.previous_features import LANES as SEEN
from salpcc.stages.predict.learned.previous_sweep import WarpedSweep, given
from salpcc.stages.predict.learned.range_features import SCALE_BITS
from salpcc.stages.predict.learned.value_intervals import (
    BITS,
    LANES,
    OUTPUT_PLACES,
    ROOM,
    ROWS,
    VALUES,
    find_value,
    frequencies,
    value_start,
)
from salpcc.stages.predict.learned.vectors import kernel, load, push, spread, store
from salpcc.stages.predict.ring_rows import PAD, align, place_rings
from salpcc.stages.predict.sweep_walk import laser_constants

PREDICT, DECODE, COLLECT = 0, 1, 2
_NO_INTERVALS = np.zeros((0, 2), np.uint32)
_ZERO, _START = np.float32(0.0), np.float32(3.0)
_OLD, _NEW = np.float32(0.75), np.float32(0.25)  # weights of running means
_NO_KEEP = np.zeros(0, np.bool_)
_NO_ROWS = (np.zeros((0, 0), np.int16), np.zeros((0, 0), np.uint8))


@kernel
def _ring(  # type: ignore[no-untyped-def]
    mode, k, lo, m, intensity, constants, layers, intervals, state, data, keep, rows, rows_x, rows_side,
    azimuth, inverse, values, above, second, below, places, there, gaps, scratch, before, seen, cones,
):  # fmt: skip
    """Visit the returns of ring k, ``lo`` to ``lo + m``; return how many rows there are now."""
    frame1, inverse1, intensity1, index1, has1 = above
    inverse2, intensity2, index2 = second
    inverse3, index3 = below
    x, h, sums, freq = scratch
    quotient = constants[k, 0]
    width = layers.first.shape[1] >> 1
    tables = layers.tables
    shift = layers.shifts[len(layers.shifts) - 1] + SCALE_BITS
    left, activity = spread(NONE, 8), _START
    if before is not None:
        number, _, rows_inverse, rows_height, rows_intensity = before
        frames, indices, of_rows, weights, seen_values = seen
        slots_there(k, number, of_rows)
        change, bias = _START, _ZERO
    for i in range(m):
        by_left, by_above, mean = intensity_features(
            i, azimuth, inverse, left, frame1, inverse1, intensity1, index1, has1, inverse2, intensity2, index2,
            inverse3, index3, quotient, activity, places, there, gaps, x,
        )  # fmt: skip
        if before is not None:
            slots = gather(
                i,
                k,
                azimuth[PAD + i],
                frames,
                indices,
                of_rows,
                rows_inverse,
                rows_height,
                rows_intensity,
                cones[k],
            )
            once, expected = previous_intensity(
                inverse[PAD + i], quotient, slots, weights, seen_values, change, bias, x
            )
        value = 0
        if mode == COLLECT:
            value = int(intensity[lo + i])
            if keep[lo + i]:
                for p in range(rows_x.shape[1]):
                    rows_x[rows, p] = x[INTENSITY_PLACES[p]]
                rows_side[rows, 0] = by_left
                rows_side[rows, 1] = by_above
                if before is not None:
                    rows_side[rows, 2] = once
                rows += 1
        else:
            height = tables.shape[1]
            for j in range(0, width, 16):
                bias_j = load(tables, k * width + j, 16) + load(tables, (height + by_left) * width + j, 16)
                bias_j = bias_j + load(tables, (2 * height + by_above) * width + j, 16)
                if before is not None:
                    bias_j = bias_j + load(tables, (3 * height + once) * width + j, 16)
                store(sums, j, bias_j)
            forward(x, k, layers, h, sums)
            total = frequencies(sums, shift, freq)
            if mode == PREDICT:
                value = int(intensity[lo + i])
                cum = value_start(freq, value)
            else:
                value, cum = find_value(freq, total, decode_target(state, BITS))
            low = (cum << BITS) // total
            high = ((cum + int(freq[value % ROWS * LANES + value // ROWS])) << BITS) // total
            if mode == PREDICT:
                intervals[lo + i, 0] = low
                intervals[lo + i, 1] = high - low
            else:
                decode_interval(state, data, low, high - low, BITS)
                intensity[lo + i] = value
        real = np.float32(value)
        values[PAD + i] = real
        left = push(left, real)
        if before is not None:
            off = real - expected
            change = _OLD * change + _NEW * abs(off)
            bias = _OLD * bias + _NEW * off
        activity = _OLD * activity + _NEW * abs(real - mean)
    return rows


@njit(cache=True, error_model="numpy", nogil=True)
def walk(  # type: ignore[no-untyped-def]
    mode, starts, azimuth, inverse, intensity, constants, layers, intervals, state, data, keep, rows_x, rows_side,
    before, cones,
):  # fmt: skip
    """Predict ``intensity`` (fills ``intervals``), decode it, or collect rows of the returns in ``keep``."""
    n_rings = len(starts) - 1
    size = azimuth.shape[1]
    if before is None:
        seen = None
    else:
        number, rows_azimuth, rows_inverse, _, _ = before
        frames = np.zeros((3, rows_azimuth.shape[1]), np.float32)
        indices = np.full((3, size), PAD, np.int32)
        seen = (
            frames,
            indices,
            np.zeros(SEEN, np.float32),
            np.zeros(SEEN, np.float32),
            np.zeros(SEEN, np.float32),
        )
    values = np.zeros((3, size), np.float32)
    near, places_of = np.zeros((3, size), np.float32), np.full((3, size), PAD, np.int32)
    count = np.zeros(3, np.int64)
    unused = np.zeros(size, np.float32)
    places, there = np.zeros((LEFT + 1, 32), np.float32), np.zeros((LEFT + 1, 32), np.float32)
    gaps = np.zeros((size, GAPS), np.int16)
    width = layers.first.shape[1] >> 1
    scratch = (
        np.zeros(layers.first.shape[0] * 2 + 16, np.int16), np.zeros(width, np.int16),
        np.zeros(max(width, layers.last.shape[1] >> 1), np.int32), np.zeros(ROOM, np.int32),
    )  # fmt: skip
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
        if before is not None:
            for r in range(max(k - 1, 0), min(k + 2, n_rings)):
                if number[r] > 0:
                    align(
                        rows_azimuth[r], rows_inverse[r], number[r], -constants[k, 4], azimuth[k], m,
                        frames[r - k + 1], indices[r - k + 1], unused,
                    )  # fmt: skip
        has1, has2 = count[0] > 0, count[1] > 0
        slot_places(has1, has2, count[2] > 0, places, there)
        ring_gaps(m, azimuth[k], near[0], places_of[0], has1, has2, gaps)
        current = values[k % 3]
        rows = _ring(
            mode, k, lo, m, intensity, constants, layers, intervals, state, data, keep, rows, rows_x, rows_side,
            azimuth[k], inverse[k], current, (near[0], inverse[up], values[(k + 2) % 3], places_of[0], has1),
            (inverse[second], values[(k + 1) % 3], places_of[1]), (inverse[down], places_of[2]),
            places, there, gaps, scratch, before, seen, cones,
        )  # fmt: skip
        for p in range(PAD):
            current[PAD - 1 - p] = current[PAD + m - 1 - p % m]
            current[PAD + m + p] = current[PAD + p % m]


def _packed(network: Network, before: WarpedSweep | None) -> Layers:
    """The network's weights in the order of features and values."""
    return pack(network, INTENSITY_PLACES[: INPUTS + INTENSITY_INPUTS * (before is not None)], OUTPUT_PLACES)


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
        PREDICT, starts, azimuth, inverse, intensity, constants, _packed(network, before), intervals,
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
        DECODE, starts, azimuth, inverse, intensity, constants, _packed(network, before), _NO_INTERVALS, state,
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
    none = _packed(Network.empty(x.shape[1]), before)
    walk(
        COLLECT, starts, azimuth, inverse, intensity, constants, none, _NO_INTERVALS,
        start_decoder(np.zeros(1, np.uint8)), np.zeros(1, np.uint8), keep, x, sides, *given(before, sensor),
    )  # fmt: skip
    return x, sides
