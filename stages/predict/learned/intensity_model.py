"""Predict the intensities (0..100) of a sweep whose ranges are known; encoder and decoder are one walk.

Stream: one interval of 2 ** 24 per return in firing order. The network's 101 logits become integer
frequencies; their running sums, scaled to 2 ** 24, are the intervals.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.entropy.range_coder import decode_interval, decode_target
from salpcc.stages.lattice.sensor_model import SensorModel
from salpcc.stages.predict.learned.intensity_features import (
    GAPS,
    INPUTS,
    LEFT,
    NONE,
    RingBeside,
    Slots,
    intensity_features,
    ring_gaps,
    slot_places,
)
from salpcc.stages.predict.learned.network import Layers, Network, forward, pack
from salpcc.stages.predict.learned.previous_features import (
    INTENSITY_INPUTS,
    INTENSITY_PLACES,
    align_seen,
    gather,
    previous_intensity,
    see,
    slots_there,
)
from salpcc.stages.predict.learned.previous_sweep import WarpedSweep
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
from salpcc.stages.predict.learned.walks import COLLECT, DECODE, NO_ROWS, PREDICT, Rows, to_decode, to_predict
from salpcc.stages.predict.ring_rows import PAD, align, place_rings
from salpcc.stages.predict.sweep_walk import laser_constants
from salpcc.stages.predict.vectors import kernel, load, push, spread, store

_ZERO, _START = np.float32(0.0), np.float32(3.0)
_OLD, _NEW = np.float32(0.75), np.float32(0.25)  # weights of running means

F32 = NDArray[np.float32]


class _Ring(NamedTuple):
    """The ring at hand, ``(size,)`` each, margins cyclic: azimuths, inverse ranges, intensities as they are known."""

    azimuth: F32
    inverse: F32
    intensity: F32


class _Scratch(NamedTuple):
    """Room for one return: inputs, hidden values and sums of the network, frequencies of all values."""

    x: NDArray[np.int16]
    hidden: NDArray[np.int16]
    sums: NDArray[np.int32]
    frequencies: NDArray[np.int32]


@kernel
def _walk_ring(  # type: ignore[no-untyped-def]
    mode, k, lo, m, intensity, quotient, layers, coded, rows, row, ring, above, second, below, slots, scratch, before, seen
):  # fmt: skip
    """Visit the returns of ring k, ``lo`` to ``lo + m``; return how many rows there are now."""
    azimuth, inverse, values = ring
    x, h, sums, freq = scratch
    width = layers.first.shape[1] >> 1
    tables = layers.tables
    shift = layers.shifts[len(layers.shifts) - 1] + SCALE_BITS
    left, activity = spread(NONE, 8), _START
    if before is not None:
        slots_there(k, before.number, seen.there)
        change, bias = _START, _ZERO
    for i in range(m):
        by_left, by_above, mean = intensity_features(
            i, azimuth, inverse, left, above, second, below, quotient, activity, slots, x
        )
        if before is not None:
            around = gather(i, k, azimuth[PAD + i], before, seen)
            once, expected = previous_intensity(inverse[PAD + i], quotient, around, seen, change, bias, x)
        value = 0
        if mode == COLLECT:
            value = int(intensity[lo + i])
            if rows.keep[lo + i]:
                for p in range(rows.inputs.shape[1]):
                    rows.inputs[row, p] = x[INTENSITY_PLACES[p]]
                rows.beside[row, 0] = by_left
                rows.beside[row, 1] = by_above
                if before is not None:
                    rows.beside[row, 2] = once
                row += 1
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
                value, cum = find_value(freq, total, decode_target(coded.state, BITS))
            low = (cum << BITS) // total
            high = ((cum + int(freq[value % ROWS * LANES + value // ROWS])) << BITS) // total
            if mode == PREDICT:
                coded.intervals[lo + i, 0] = low
                coded.intervals[lo + i, 1] = high - low
            else:
                decode_interval(coded.state, coded.data, low, high - low, BITS)
                intensity[lo + i] = value
        real = np.float32(value)
        values[PAD + i] = real
        left = push(left, real)
        if before is not None:
            off = real - expected
            change = _OLD * change + _NEW * abs(off)
            bias = _OLD * bias + _NEW * off
        activity = _OLD * activity + _NEW * abs(real - mean)
    return row


@njit(cache=True, error_model="numpy", nogil=True)
def walk(  # type: ignore[no-untyped-def]
    mode, starts, azimuth, inverse, intensity, constants, layers, coded, rows, before
):
    """Predict ``intensity`` (fills ``coded.intervals``), decode it, or collect rows of the returns in ``rows.keep``."""
    n_rings = len(starts) - 1
    size = azimuth.shape[1]
    seen = None if before is None else see(before, size)
    values = np.zeros((3, size), np.float32)
    near, places_of = np.zeros((3, size), np.float32), np.full((3, size), PAD, np.int32)
    count = np.zeros(3, np.int64)
    unused = np.zeros(size, np.float32)
    places, there = np.zeros((LEFT + 1, 32), np.float32), np.zeros((LEFT + 1, 32), np.float32)
    slots = Slots(places, there, np.zeros((size, GAPS), np.int16))
    width = layers.first.shape[1] >> 1
    scratch = _Scratch(
        np.zeros(layers.first.shape[0] * 2 + 16, np.int16), np.zeros(width, np.int16),
        np.zeros(max(width, layers.last.shape[1] >> 1), np.int32), np.zeros(ROOM, np.int32),
    )  # fmt: skip
    row = 0
    for k in range(n_rings):
        lo = starts[k]
        m = starts[k + 1] - lo
        if m == 0:
            continue
        up, over, down = max(k - 1, 0), max(k - 2, 0), min(k + 1, n_rings - 1)
        count[0] = starts[k] - starts[up]
        count[1] = starts[up] - starts[over]
        count[2] = starts[down + 1] - starts[down] if down > k else 0
        for r, ring in enumerate((up, over, down)):
            if count[r] > 0:
                align(
                    azimuth[ring], inverse[ring], count[r], constants[ring, 4] - constants[k, 4],
                    azimuth[k], m, near[r], places_of[r], unused,
                )  # fmt: skip
        if before is not None:
            align_seen(k, before, azimuth[k], m, constants[k, 4], seen, unused)
        current = _Ring(azimuth[k], inverse[k], values[k % 3])
        above = RingBeside(near[0], inverse[up], values[(k + 2) % 3], places_of[0], count[0] > 0)
        second = RingBeside(near[1], inverse[over], values[(k + 1) % 3], places_of[1], count[1] > 0)
        below = RingBeside(near[2], inverse[down], unused, places_of[2], count[2] > 0)
        slot_places(above.there, second.there, below.there, places, there)
        ring_gaps(m, azimuth[k], above, second.there, slots.gaps)
        row = _walk_ring(
            mode, k, lo, m, intensity, constants[k, 0], layers, coded, rows, row, current, above, second, below, slots,
            scratch, before, seen,
        )  # fmt: skip
        for p in range(PAD):
            current.intensity[PAD - 1 - p] = current.intensity[PAD + m - 1 - p % m]
            current.intensity[PAD + m + p] = current.intensity[PAD + p % m]


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
    coded, layers = to_predict(len(intensity)), _packed(network, before)
    walk(PREDICT, starts, azimuth, inverse, intensity, constants, layers, coded, NO_ROWS, before)
    return coded.intervals


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
    coded, layers = to_decode(data), _packed(network, before)
    walk(DECODE, starts, azimuth, inverse, intensity, constants, layers, coded, NO_ROWS, before)
    return intensity, bool(coded.state[3] == 0)


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
    rows = Rows(keep, x, sides, NO_ROWS.target)
    none = _packed(Network.empty(x.shape[1]), before)
    walk(COLLECT, starts, azimuth, inverse, intensity, constants, none, to_predict(0), rows, before)
    return x, sides
