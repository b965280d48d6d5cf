"""Code the ranges of a sweep with the learned mixture; encoder and decoder are one walk."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.schemas.errors import SalpccError
from salpcc.stages.predict.learned.features import (
    INPUTS,
    PAD,
    PREDICTORS,
    WORK,
    align,
    close_ring,
    note_errors,
    point_features,
)
from salpcc.stages.predict.learned.mixture import (
    BITS,
    COMPONENTS,
    TOTAL,
    find_level,
    level_start,
    set_mixture,
)
from salpcc.stages.predict.learned.network import Network, forward
from salpcc.stages.predict.learned.sweep_walk import height_ratio, laser_constants, step_feature
from salpcc.stages.residual_code.range_coder import (
    decode_interval,
    decode_target,
    encode_interval,
    finish_encoder,
    start_decoder,
    start_encoder,
)

LEVEL_LIMIT = 1 << 17
_HEADER = 3


@njit(cache=True, error_model="numpy")
def _walk(  # type: ignore[no-untyped-def]
    decoding,
    ring_start,
    tick,
    level,
    step,
    levels,
    constants,
    lever,
    first,
    tables,
    hidden,
    hidden_bias,
    last,
    last_bias,
    scales,
    state,
    data,
):
    """Encode ``level`` into ``data`` or decode it from there."""
    n_rings = len(ring_start) - 1
    longest = 0
    for k in range(n_rings):
        longest = max(longest, ring_start[k + 1] - ring_start[k])
    size = longest + 2 * PAD
    azimuth = np.zeros((3, size), np.float32)
    inverse = np.zeros((3, size), np.float32)
    error = np.zeros((3, size, PREDICTORS), np.float32)
    count = np.zeros(3, np.int64)
    frame1 = np.zeros(size, np.float32)
    frame2 = np.zeros(size, np.float32)
    index1 = np.zeros(longest, np.int32)
    index2 = np.zeros(longest, np.int32)
    value1 = np.zeros(longest, np.float32)
    value2 = np.zeros(longest, np.float32)
    error0 = np.zeros(PREDICTORS, np.float32)
    work = np.zeros(WORK, np.float32)
    x = np.zeros(INPUTS, np.float32)
    mu = np.zeros(PREDICTORS, np.float32)
    h = np.zeros(first.shape[1], np.float32)
    acc = np.zeros(first.shape[1], np.float32)
    out = np.zeros(last.shape[1], np.float32)
    mix = np.zeros((3, COMPONENTS))
    sf = np.float32(step_feature(step))
    middle = np.float32((step - 1) * 0.5)
    for k in range(n_rings):
        r0, r1, r2 = k % 3, (k + 2) % 3, (k + 1) % 3
        lo = ring_start[k]
        m = ring_start[k + 1] - lo
        count[r0] = m
        if m == 0:
            continue
        q, off, turn = constants[k, 0], constants[k, 1], constants[k, 3]
        for i in range(m):
            azimuth[r0, PAD + i] = np.float32(tick[lo + i]) + turn
        has1 = k >= 1 and count[r1] > 0
        has2 = k >= 2 and count[r2] > 0 and has1
        if has1:
            align(
                azimuth[r1],
                inverse[r1],
                count[r1],
                lever[k - 1] - lever[k],
                azimuth[r0],
                m,
                frame1,
                index1,
                value1,
            )
        if has2:
            align(
                azimuth[r2],
                inverse[r2],
                count[r2],
                lever[k - 2] - lever[k],
                azimuth[r0],
                m,
                frame2,
                index2,
                value2,
            )
        ratio = np.float32(height_ratio(constants[:, 2], k))
        error0[:] = np.float32(1.5)
        for i in range(m):
            point_features(
                i,
                m,
                azimuth[r0],
                inverse[r0],
                frame1,
                inverse[r1],
                error[r1],
                index1,
                value1,
                has1,
                frame2,
                inverse[r2],
                index2,
                value2,
                has2,
                ratio,
                q,
                off,
                sf,
                error0,
                work,
                x,
                mu,
            )
            for j in range(len(acc)):
                acc[j] = tables[0, k, j]
            forward(x, k, first, hidden, hidden_bias, last, last_bias, scales, h, acc, out)
            n = set_mixture(out, mu, mix)
            if decoding:
                target = decode_target(state, BITS)
                value, low, high = find_level(mix, n, target, step, levels)
                decode_interval(state, data, low, high - low, BITS)
                level[lo + i] = value
            else:
                value = level[lo + i]
                low = level_start(mix, n, value, step, levels)
                high = level_start(mix, n, value + 1, step, levels)
                encode_interval(state, data, low, high - low, BITS)
            actual = np.float32(value * step) + middle
            inverse[r0, PAD + i] = q / max(actual + off, np.float32(1.0))
            note_errors(actual, mu, error0, error[r0, PAD + i])
        close_ring(azimuth[r0], inverse[r0], error[r0], m)


def encode_ranges(ring_start, tick, level, step, sensor, network) -> NDArray[np.uint8]:  # type: ignore[no-untyped-def]
    """Return the bytes of a sweep's range levels."""
    levels = int(level.max()) + 1 if len(level) else 1
    if levels > LEVEL_LIMIT or (len(level) and level.min() < 0):
        raise SalpccError("range levels outside 0..131071")
    data = np.zeros(len(level) * 4 + 64, np.uint8)
    state = start_encoder()
    constants = laser_constants(sensor["theta"], sensor["phi0"], sensor["d0"])
    _walk(
        False,
        ring_start,
        tick,
        level,
        step,
        levels,
        constants,
        sensor["h"],
        *network.arrays(),
        state,
        data,
    )
    size = finish_encoder(state, data)
    if size < 0:
        raise SalpccError("range coder: buffer too small")
    return np.concatenate([np.frombuffer(levels.to_bytes(_HEADER, "little"), np.uint8), data[:size]])


def decode_ranges(ring_start, tick, data, step, sensor, network) -> NDArray[np.int32]:  # type: ignore[no-untyped-def]
    """Return the range levels; inverse of :func:`encode_ranges`."""
    levels = int.from_bytes(data[:_HEADER].tobytes(), "little")
    if not 1 <= levels <= LEVEL_LIMIT:
        raise SalpccError("range levels damaged")
    level = np.zeros(len(tick), np.int32)
    body = data[_HEADER:]
    constants = laser_constants(sensor["theta"], sensor["phi0"], sensor["d0"])
    _walk(
        True,
        ring_start,
        tick,
        level,
        step,
        levels,
        constants,
        sensor["h"],
        *network.arrays(),
        start_decoder(body),
        body,
    )
    return level
