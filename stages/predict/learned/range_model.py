"""Predict the range levels of a sweep with the learned mixture; encoder and decoder are one walk.

Stream: the number of levels (3 bytes, little endian), then one interval of 2 ** 24 per return, wave after wave
(:mod:`.walks`), coded by :mod:`salpcc.stages.entropy.intervals`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.entropy.intervals import STATES, take, target
from salpcc.stages.lattice.sensor_model import SensorModel
from salpcc.stages.predict.learned.local_plane import SECOND, UPPER
from salpcc.stages.predict.learned.mixture import (
    PLACES,
    SIZE,
    find_levels,
    level_ends,
    output_places,
    set_mixture,
)
from salpcc.stages.predict.learned.network import POINTS, Layers, Network, begin, forward, pack
from salpcc.stages.predict.learned.previous_features import (
    INPUT_PLACES,
    gather,
    previous_features,
    see,
)
from salpcc.stages.predict.learned.previous_features import INPUTS as PREVIOUS_INPUTS
from salpcc.stages.predict.learned.previous_features import PREDICTORS as PREVIOUS_PREDICTORS
from salpcc.stages.predict.learned.previous_sweep import WarpedSweep
from salpcc.stages.predict.learned.range_features import (
    INPUTS,
    NO_ERROR,
    PREDICTORS,
    SCALE_BITS,
    Around,
    Laser,
    Rings,
    point_features,
    slot_places,
    squashed_errors,
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
from salpcc.stages.predict.ring_rows import PAD, across, follow, lever_ticks, place_azimuths, row_size
from salpcc.stages.predict.sweep_walk import height_ratio, laser_constants, step_feature
from salpcc.stages.vectors import inline, kernel, lane, load, pick, store

LEVEL_LIMIT = 1 << 17  # levels of a sweep; a return beyond cannot be coded here
HEADER = 3
_HALF, _ONE = np.float32(0.5), np.float32(1.0)
_FIRING, _TURN = np.float32(2.0), np.float32(4000.0)  # ticks

F32 = NDArray[np.float32]
I64 = NDArray[np.int64]


class _Levels(NamedTuple):
    """The levels ``(M,)`` of a sweep, ``step`` counts each, all below ``number``; ``constants`` of its lasers."""

    level: NDArray[np.int32]
    step: int
    number: int
    constants: F32


class _Reached(NamedTuple):
    """How far the walk has come in each ring.

    Attributes:
        n: ``(L,)`` returns that are known.
        near: ``(L, 2)`` places of the last returns of the two rings above that are not after the ring's next one.
        value2: ``(L,)`` inverse range of the second ring at the next return.
        error: ``(L, 16)`` running squashed errors; signed: ``(L,)`` error of the first predictor by the sweep before.
    """

    n: I64
    near: I64
    value2: F32
    error: F32
    signed: F32


class _Sweep(NamedTuple):
    """A sweep on the way: where its rings start ``(L + 1,)``, the rings, how far the walk has come, and what is the same for all returns of a ring.

    Attributes:
        levers: ``(L, 2)`` by how many ticks, per inverse range, the two rings above are moved into the frame of a ring.
        heights: ``(L,)`` of :class:`.range_features.Laser`; places: of :func:`.range_features.slot_places`.
    """

    starts: I64
    rings: Rings
    reached: _Reached
    levers: F32
    heights: F32
    places: F32


class _Scratch(NamedTuple):
    """Room for a wave: a row for each return's inputs, mixture and predictions; for those that the network takes at once, and those that are looked for."""

    x: NDArray[np.int16]
    mixture: F32
    predicted: F32
    hidden: NDArray[np.int16]
    sums: NDArray[np.int32]
    search: I64


@inline
def _see(k, sweep):  # type: ignore[no-untyped-def]
    """Find what is above the next return of ring k, which has one; whether all that it is predicted from is known."""
    starts, rings, reached = sweep.starts, sweep.rings, sweep.reached
    ring, i = np.uint64(k), reached.n[np.uint64(k)]
    a = rings.azimuth[ring, np.uint64(PAD + i)]
    n = 0 if k < 1 else starts[k] - starts[k - 1]
    if n == 0:
        return True
    known = reached.n[np.uint64(k - 1)]
    j = follow(rings.above, k, reached.near[ring, 0], PAD + known, a)
    reached.near[ring, 0] = j
    if known < n and j + UPPER // 2 >= PAD + known:
        return False
    n2 = 0 if k < 2 else starts[k - 1] - starts[k - 2]
    if n2 > 0:
        known = reached.n[np.uint64(k - 2)]
        j2 = follow(rings.second, k, reached.near[ring, 1], PAD + known, a)
        reached.near[ring, 1] = j2
        if known < n2 and j2 + SECOND // 2 >= PAD + known:
            return False
        reached.value2[ring] = across(rings.second, k, rings.inverse, k - 2, j2, a)
    rings.value[ring, np.uint64(PAD + i)] = across(rings.above, k, rings.inverse, k - 1, j, a)
    return True


@inline
def _learn(k, n, actual, error, rings, reached, levers, laser):  # type: ignore[no-untyped-def]
    """Let ring k of n returns know its next one, ``actual`` counts, whose predictors have errors."""
    ring, i = np.uint64(k), reached.n[np.uint64(k)]
    w = laser.quotient / max(actual + laser.offset, _ONE)
    at = PAD + i
    _place(k, at, rings.azimuth[ring, np.uint64(at)], w, error, rings, levers)
    reached.n[ring] = i + 1
    if i == 0:
        for p in range(PAD - 1, -1, -1):
            a = rings.azimuth[ring, np.uint64(p + 1)] - _FIRING
            rings.azimuth[ring, np.uint64(p)] = a
            _place(k, p, a, w, error, rings, levers)
    if i + 1 == n:
        for p in range(PAD):
            first = PAD + p % n
            a = rings.azimuth[ring, np.uint64(first)] + np.float32(1 + p // n) * _TURN
            rings.azimuth[ring, np.uint64(PAD + n + p)] = a
            _place(k, PAD + n + p, a, rings.inverse[ring, np.uint64(first)], error, rings, levers)


@inline
def _place(k, at, a, w, error, rings, levers):  # type: ignore[no-untyped-def]
    """Let a return of ring k, or a copy of it in a margin, stand at a place, and in the frames of the two rings below."""
    ring, place = np.uint64(k), np.uint64(at)
    rings.inverse[ring, place] = w
    store(rings.error, (k * rings.azimuth.shape[1] + at) * 16, error)
    if k + 1 < rings.azimuth.shape[0]:
        rings.above[np.uint64(k + 1), place] = a + levers[np.uint64(k + 1), 0] * w
    if k + 2 < rings.azimuth.shape[0]:
        rings.second[np.uint64(k + 2), place] = a + levers[np.uint64(k + 2), 1] * w


@inline
def _predict(p, k, sweep, laser, scratch, before, seen):  # type: ignore[no-untyped-def]
    """Fill row p of the inputs and of the predictions with those of the next return of ring k."""
    starts, rings, reached = sweep.starts, sweep.rings, sweep.reached
    ring = np.uint64(k)
    above = k > 0 and starts[k - 1] < starts[k]
    second = above and k > 1 and starts[k - 2] < starts[k - 1]
    near, i = reached.near[ring, 0], reached.n[ring]
    around = Around(k, i, above, second, near, reached.near[ring, 1], reached.value2[ring])
    error0, to = load(reached.error, k * 16, 16), p * scratch.x.shape[1]
    w1, tight, slope_u, slope_v, base, counts = point_features(
        around, starts[k + 1] - starts[k], rings, laser, sweep.places, error0, scratch.x, to
    )
    if before is None:
        counts = pick(counts, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 0, 0, 0, 0, 0)
    else:
        seen_there = gather(i, k, rings.azimuth[ring, np.uint64(PAD + i)], before, seen)
        at = (max(k - 1, 0) * rings.azimuth.shape[1] + near) * 16
        counts = previous_features(
            w1, tight, slope_u, slope_v, base, laser, seen_there, reached.signed[ring], error0, above, at,
            rings.error, scratch.x, to, counts,
        )  # fmt: skip
    store(scratch.predicted, p * PLACES, counts)


@inline
def _weigh(n, wave, layers, levels, scratch):  # type: ignore[no-untyped-def]
    """Ask the network for the mixtures of a wave of n."""
    width, sums = layers.first.shape[1] >> 1, scratch.sums
    shift = layers.shifts[len(layers.shifts) - 1] + SCALE_BITS
    for q in range(0, n, POINTS):
        for p in range(POINTS):
            begin(sums, p, layers.tables, wave[q + p] * width, width)
        forward(scratch.x, q, wave, layers, scratch.hidden, sums)
        for p in range(min(POINTS, n - q)):
            set_mixture(sums, p, shift, scratch.predicted, q + p, levels, scratch.mixture)


@inline
def _decode(n, done, wave, sweep, levels, coded, scratch):  # type: ignore[no-untyped-def]
    """Decode the levels of a wave of n, ``done`` in all before."""
    search = scratch.search
    for q in range(0, n, STATES):
        some = min(STATES, n - q)
        for p in range(some):
            search[0, p] = target(coded.state, done + q + p)
        find_levels(scratch.mixture, q, some, levels.step, levels.number, search)
        for p in range(some):
            k = wave[q + p]
            levels.level[sweep.starts[k] + sweep.reached.n[np.uint64(k)]] = search[1, p]
            take(coded.state, coded.words, done + q + p, search[2, p], search[3, p] - search[2, p])


@kernel
def _walk(mode, sweep, levels, layers, coded, rows, wave, scratch, before, seen):  # type: ignore[no-untyped-def]
    """Visit all returns, wave after wave."""
    level, step, number, constants = levels
    starts, reached, mu = sweep.starts, sweep.reached, scratch.predicted
    step_value, middle = np.float32(step_feature(step)), np.float32((step - 1) * 0.5)
    done = top = 0
    while done < len(level):
        top, n = next_wave(_see, sweep, top, starts, reached.n, wave)
        for p in range(n):
            ring = np.uint64(wave[p])
            laser = Laser(constants[ring, 0], constants[ring, 1], sweep.heights[ring], step_value)
            _predict(p, wave[p], sweep, laser, scratch, before, seen)
        if mode != COLLECT:
            _weigh(n, wave, layers, number, scratch)
        if mode == DECODE:
            _decode(n, done, wave, sweep, levels, coded, scratch)
        for p in range(n):
            k = wave[p]
            ring = np.uint64(k)
            i = starts[k] + reached.n[ring]
            value = int(level[i])
            coded.order[done + p] = k
            if mode == PREDICT:
                low, high = level_ends(scratch.mixture, p, value, step, number)
                coded.intervals[done + p, 0] = low
                coded.intervals[done + p, 1] = high - low
            actual = np.float32(value * step) + middle
            if mode == COLLECT and rows.place[i] >= 0:
                row = rows.place[i]
                for f in range(rows.inputs.shape[1]):
                    rows.inputs[row, f] = scratch.x[p, INPUT_PLACES[f]]
                for f in range(rows.beside.shape[1]):
                    rows.beside[row, f] = mu[p, f] - mu[p, PREDICTORS - 1]
                rows.target[row] = actual - mu[p, PREDICTORS - 1]
            counts = load(mu, p * PLACES, 16)
            error = squashed_errors(actual, counts)
            store(reached.error, k * 16, (load(reached.error, k * 16, 16) + error) * _HALF)
            if before is not None:
                reached.signed[ring] = actual - lane(counts, PREDICTORS)
            laser = Laser(constants[ring, 0], constants[ring, 1], sweep.heights[ring], step_value)
            _learn(k, starts[k + 1] - starts[k], actual, error, sweep.rings, reached, sweep.levers, laser)
        done += n


@njit(cache=True, error_model="numpy", nogil=True)
def walk(mode, starts, tick, levels, layers, coded, rows, before):  # type: ignore[no-untyped-def]
    """Visit every return, wave after wave: predict its level, decode it, or collect rows.

    PREDICT fills ``coded.intervals`` with where each level lies in its predicted distribution.
    COLLECT fills one training row per return with a ``rows.place``: features, predictions and the actual
    count, both relative to the base, in counts.

    ``before`` is a :class:`WarpedSweep`, or None for a network that does not ask for it.
    """
    n_rings, size = len(starts) - 1, row_size(starts)
    constants = levels.constants
    rings = Rings(
        place_azimuths(starts, tick, constants), np.zeros((n_rings, size), np.float32), np.empty((n_rings, size, 16), np.float32),
        np.zeros((n_rings, size), np.float32), np.zeros((n_rings, size), np.float32), np.zeros((n_rings, size), np.float32),
    )  # fmt: skip
    reached = _Reached(
        np.zeros(n_rings, np.int64), np.full((n_rings, 2), PAD - 1, np.int64), np.zeros(n_rings, np.float32),
        np.full((n_rings, 16), NO_ERROR, np.float32), np.zeros(n_rings, np.float32),
    )  # fmt: skip
    levers, heights = np.zeros((n_rings, 2), np.float32), np.zeros(n_rings, np.float32)
    for k in range(n_rings):
        heights[k] = height_ratio(constants, k)
        for r in range(2):
            levers[k, r] = lever_ticks(constants[max(k - 1 - r, 0), 4] - constants[k, 4])
    seen = None if before is None else see(before, starts, rings.azimuth, constants)
    width, outputs = layers.first.shape[1] >> 1, layers.last.shape[1] >> 1
    most = RINGS + POINTS
    scratch = _Scratch(
        np.zeros((most, layers.first.shape[0] * 2 + 16), np.int16), np.zeros((most, SIZE), np.float32),
        np.zeros((most, PLACES), np.float32),
        np.zeros((POINTS, width), np.int16), np.zeros((POINTS, max(width, outputs)), np.int32), np.zeros((7, STATES), np.int64),
    )  # fmt: skip
    sweep = _Sweep(starts, rings, reached, levers, heights, slot_places())
    _walk(mode, sweep, levels, layers, coded, rows, np.zeros(most, np.int64), scratch, before, seen)


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
) -> tuple[NDArray[np.uint32], NDArray[np.uint8]]:
    """Predict every level ``(M,)`` from the returns before it.

    Returns:
        ``(M, 2)`` start and width, of ``2 ** BITS``, of the interval that the predicted distribution gives
        to the actual level, in the order of coding; and the laser ``(M,)`` of each.

    Raises:
        ValueError: a level outside ``[0, LEVEL_LIMIT)``.
    """
    levels = count_levels(level)
    if levels > LEVEL_LIMIT or (len(level) and int(level.min()) < 0):
        raise ValueError(f"range levels must lie in 0..{LEVEL_LIMIT - 1}")
    coded = to_predict(len(level))
    of_sweep = _Levels(level, step, levels, laser_constants(sensor))
    walk(PREDICT, starts, tick, of_sweep, _packed(network, before), coded, NO_ROWS, before)
    return coded.intervals, coded.order


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
    :func:`predict_ranges` and the coder."""
    level = np.zeros(len(tick), np.int32)
    levels = int.from_bytes(data[:HEADER].tobytes(), "little")
    if len(data) < HEADER or not 1 <= levels <= LEVEL_LIMIT:
        return level, False
    coded = to_decode(len(level), data[HEADER:])
    if coded is None:
        return level, False
    of_sweep = _Levels(level, step, levels, laser_constants(sensor))
    walk(DECODE, starts, tick, of_sweep, _packed(network, before), coded, NO_ROWS, before)
    return level, coded.ended


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
    rows = Rows(places(keep), x, mu, np.zeros(n, np.float32))
    none = _packed(Network.empty(x.shape[1]), before)
    of_sweep = _Levels(level, step, 1, laser_constants(sensor))
    walk(COLLECT, starts, tick, of_sweep, none, to_predict(len(keep)), rows, before)
    return rows.inputs, rows.beside, rows.target
