"""Predict the intensities (0..100) of a sweep whose ranges are known; encoder and decoder are one walk.

Stream: one interval of 2 ** 24 per return, wave after wave (:mod:`.walks`). The network's 101 logits become integer
frequencies; their running sums, scaled to 2 ** 24, are the intervals.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.entropy.intervals import take, target
from salpcc.stages.lattice.sensor_model import SensorModel
from salpcc.stages.predict.learned.intensity_features import (
    INPUTS,
    Around,
    Rings,
    intensity_features,
    slot_places,
)
from salpcc.stages.predict.learned.network import POINTS, Layers, Network, forward, pack
from salpcc.stages.predict.learned.previous_features import (
    INTENSITY_INPUTS,
    INTENSITY_PLACES,
    gather,
    previous_intensity,
    see,
)
from salpcc.stages.predict.learned.previous_sweep import WarpedSweep
from salpcc.stages.predict.learned.range_features import SCALE_BITS
from salpcc.stages.predict.learned.value_intervals import (
    BITS,
    OUTPUT_PLACES,
    ROOM,
    VALUES,
    find_value,
    frequencies,
    frequency,
    value_start,
)
from salpcc.stages.predict.learned.walks import (
    COLLECT,
    DECODE,
    NO_ROWS,
    PREDICT,
    RINGS,
    Rows,
    next_wave,
    places,
    to_decode,
    to_predict,
)
from salpcc.stages.predict.ring_rows import PAD, align, place_rings
from salpcc.stages.predict.sweep_walk import laser_constants
from salpcc.stages.vectors import inline, kernel, load, store

_START = np.float32(3.0)
_OLD, _NEW = np.float32(0.75), np.float32(0.25)  # weights of running means

F32 = NDArray[np.float32]
I64 = NDArray[np.int64]


class _Reached(NamedTuple):
    """How far the walk has come in each ring: ``(L,)`` returns that are known, and running means: errors of the local mean, and what the mean by the sweep before was off by, with ``expected``, what it was."""

    n: I64
    activity: F32
    change: F32
    bias: F32
    mean: F32
    expected: F32


class _Scratch(NamedTuple):
    """Room for a wave: a row of inputs for each return, what its first sums begin with, frequencies of all values, their total; and for those that the network takes at once."""

    x: NDArray[np.int16]
    beside: I64
    frequencies: NDArray[np.int32]
    total: I64
    hidden: NDArray[np.int16]
    sums: NDArray[np.int32]


@inline
def _known(k, given):  # type: ignore[no-untyped-def]
    """Whether all is known that the next return of ring k, which has one, is predicted from."""
    starts, near, reached = given
    i = reached[np.uint64(k)]
    for r in range(2):
        up = k - 1 - r
        if up >= 0 and reached[np.uint64(up)] < starts[up + 1] - starts[up]:
            j = near[np.uint64(3 * k + r), np.uint64(i)]
            if j + (4 if r == 0 else 2) >= PAD + reached[np.uint64(up)]:
                return False
    return True


@inline
def _predict(p, k, starts, rings, reached, quotient, slots, scratch, before, seen):  # type: ignore[no-untyped-def]
    """Fill row p of the inputs, and of what the first sums begin with, with those of the next return of ring k."""
    ring, i, last = np.uint64(k), reached.n[np.uint64(k)], len(starts) - 2
    at = np.uint64(i)
    around = Around(
        k, i, k > 0 and starts[max(k - 1, 0)] < starts[k], k > 1 and starts[max(k - 2, 0)] < starts[max(k - 1, 0)],
        k < last and starts[k + 1] < starts[min(k + 2, last + 1)], int(rings.near[np.uint64(3 * k), at]),
        int(rings.near[np.uint64(3 * k + 1), at]), int(rings.near[np.uint64(3 * k + 2), at]),
    )  # fmt: skip
    left = load(rings.intensity, k * rings.azimuth.shape[1] + PAD + i - 8, 8)
    x, to = scratch.x, p * scratch.x.shape[1]
    by_left, by_above, mean = intensity_features(
        around, starts[k + 1] - starts[k], rings, left, quotient, reached.activity[ring], slots, x, to
    )
    reached.mean[ring] = mean
    scratch.beside[p, 0], scratch.beside[p, 1] = by_left, by_above
    if before is not None:
        near = gather(i, k, rings.azimuth[ring, np.uint64(PAD + i)], before, seen)
        inverse = rings.inverse[ring, np.uint64(PAD + i)]
        once, expected = previous_intensity(
            inverse, quotient, near, seen, reached.change[ring], reached.bias[ring], x, to
        )
        reached.expected[ring] = expected
        scratch.beside[p, 2] = once


@kernel
def _walk(mode, starts, intensity, quotients, layers, coded, rows, rings, reached, slots, wave, scratch, before, seen):  # type: ignore[no-untyped-def]  # fmt: skip
    """Visit all returns, wave after wave."""
    freq, sums, totals = scratch.frequencies, scratch.sums, scratch.total
    shift = layers.shifts[len(layers.shifts) - 1] + SCALE_BITS
    done = top = 0
    while done < len(intensity):
        top, n = next_wave(_known, (starts, rings.near, reached.n), top, starts, reached.n, wave)
        for p in range(n):
            k = wave[p]
            _predict(p, k, starts, rings, reached, quotients[np.uint64(k)], slots, scratch, before, seen)
        if mode != COLLECT:
            for q in range(0, n, POINTS):
                for p in range(POINTS):
                    _begin(sums, p, wave[q + p], scratch.beside, q + p, layers.tables, before is not None)
                forward(scratch.x, q, wave, layers, scratch.hidden, sums)
                for p in range(min(POINTS, n - q)):
                    totals[q + p] = frequencies(sums, p, shift, freq, q + p)
        for p in range(n):
            k = wave[p]
            i = starts[k] + reached.n[np.uint64(k)]
            value, cum, total = int(intensity[i]), 0, totals[p]
            coded.order[done + p] = k
            if mode == COLLECT:
                row = rows.place[i]
                for f in range(rows.inputs.shape[1] if row >= 0 else 0):
                    rows.inputs[row, f] = scratch.x[p, INTENSITY_PLACES[f]]
                for f in range(rows.beside.shape[1] if row >= 0 else 0):
                    rows.beside[row, f] = scratch.beside[p, f]
            elif mode == PREDICT:
                cum = value_start(freq, p, value)
                low = (cum << BITS) // total
                coded.intervals[done + p, 0] = low
                coded.intervals[done + p, 1] = (((cum + frequency(freq, p, value)) << BITS) // total) - low
            else:
                value, cum = find_value(freq, p, total, target(coded.state, done + p))
                low = (cum << BITS) // total
                high = ((cum + frequency(freq, p, value)) << BITS) // total
                take(coded.state, coded.words, done + p, low, high - low)
                intensity[i] = value
            _learn(k, starts[k + 1] - starts[k], np.float32(value), rings, reached)
        done += n


@inline
def _begin(sums, p, k, beside, row, tables, looks_back):  # type: ignore[no-untyped-def]
    """Let the sums of point p begin with the rows of the tables that its laser and the intensities around it choose."""
    height, width = tables.shape[1], tables.shape[2]
    by_left, by_above = beside[row, 0], beside[row, 1]
    for j in range(0, width, 16):
        bias = load(tables, k * width + j, 16) + load(tables, (height + by_left) * width + j, 16)
        bias = bias + load(tables, (2 * height + by_above) * width + j, 16)
        if looks_back:
            bias = bias + load(tables, (3 * height + beside[row, 2]) * width + j, 16)
        store(sums, p * sums.shape[1] + j, bias)


@inline
def _learn(k: int, n: int, value: np.float32, rings: Rings, reached: _Reached) -> None:
    """Let ring k of n returns know the intensity of its next one."""
    ring, i = np.uint64(k), reached.n[np.uint64(k)]
    rings.intensity[ring, np.uint64(PAD + i)] = value
    off = value - reached.expected[ring]
    reached.change[ring] = _OLD * reached.change[ring] + _NEW * abs(off)
    reached.bias[ring] = _OLD * reached.bias[ring] + _NEW * off
    reached.activity[ring] = _OLD * reached.activity[ring] + _NEW * abs(value - reached.mean[ring])
    reached.n[ring] = i + 1
    if i == 0:
        for p in range(PAD):
            rings.intensity[ring, np.uint64(p)] = value
    if i + 1 == n:
        for p in range(PAD):
            rings.intensity[ring, np.uint64(PAD + n + p)] = rings.intensity[ring, np.uint64(PAD + p % n)]


@njit(cache=True, error_model="numpy", nogil=True)
def walk(  # type: ignore[no-untyped-def]
    mode, starts, azimuth, inverse, intensity, constants, layers, coded, rows, before
):
    """Predict ``intensity`` (fills ``coded.intervals``), decode it, or collect rows of the returns with a ``rows.place``."""
    n_rings = len(starts) - 1
    size = azimuth.shape[1]
    seen = None if before is None else see(before, starts, azimuth, constants)
    above, near = np.zeros((n_rings, size), np.float32), np.full((3 * n_rings, size), PAD, np.int32)
    unseen = np.zeros(size, np.float32)
    for k in range(n_rings):
        m = starts[k + 1] - starts[k]
        for r, ring in enumerate((k - 1, k - 2, k + 1)):
            if m > 0 and 0 <= ring < n_rings and starts[ring] < starts[ring + 1]:
                align(
                    azimuth[ring], inverse[ring], starts[ring + 1] - starts[ring], constants[ring, 4] - constants[k, 4],
                    azimuth[k], m, above[k] if r == 0 else unseen, near[3 * k + r],
                )  # fmt: skip
    rings = Rings(azimuth, inverse, np.zeros((n_rings, size), np.float32), above, near)
    reached = _Reached(
        np.zeros(n_rings, np.int64), np.full(n_rings, _START), np.full(n_rings, _START), np.zeros(n_rings, np.float32),
        np.zeros(n_rings, np.float32), np.zeros(n_rings, np.float32),
    )  # fmt: skip
    width, outputs = layers.first.shape[1] >> 1, layers.last.shape[1] >> 1
    most = RINGS + POINTS
    scratch = _Scratch(
        np.zeros((most, layers.first.shape[0] * 2 + 16), np.int16), np.zeros((most, 3), np.int64),
        np.zeros((most, ROOM), np.int32), np.zeros(most, np.int64),
        np.zeros((POINTS, width), np.int16), np.zeros((POINTS, max(width, outputs)), np.int32),
    )  # fmt: skip
    quotients = constants[:, 0].copy()
    wave = np.zeros(most, np.int64)
    _walk(
        mode, starts, intensity, quotients, layers, coded, rows, rings, reached, slot_places(), wave, scratch, before, seen
    )  # fmt: skip


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
        ``(M, 2)`` start and width, of ``2 ** BITS``, of the interval of each actual intensity, in the order of coding.

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
    :func:`predict_intensity` and the coder."""
    constants = laser_constants(sensor)
    azimuth, inverse = place_rings(starts, tick, level, step, constants)
    intensity = np.zeros(len(tick), np.uint8)
    coded, layers = to_decode(len(tick), data), _packed(network, before)
    if coded is None:
        return intensity, False
    walk(DECODE, starts, azimuth, inverse, intensity, constants, layers, coded, NO_ROWS, before)
    return intensity, coded.ended


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
    x = np.zeros((n, INPUTS + INTENSITY_INPUTS * more), np.int16)
    sides = np.zeros((n, 2 + more), np.float32)  # as those of ranges and NO_ROWS: the walk is compiled once
    constants = laser_constants(sensor)
    azimuth, inverse = place_rings(starts, tick, level, step, constants)
    rows = Rows(places(keep), x, sides, NO_ROWS.target)
    none = _packed(Network.empty(x.shape[1]), before)
    walk(COLLECT, starts, azimuth, inverse, intensity, constants, none, to_predict(len(keep)), rows, before)
    return x, sides.astype(np.uint8)
