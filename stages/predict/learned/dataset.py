"""Features and targets of whole sweeps for training."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

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
from salpcc.stages.predict.learned.sweep_walk import height_ratio, step_feature


@njit(cache=True, error_model="numpy")
def extract(ring_start, tick, level, step, constants, lever, keep, xs, mus, ys):  # type: ignore[no-untyped-def]
    """Fill one row per return with ``keep`` set; returns the number of rows."""
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
    sf = np.float32(step_feature(step))
    middle = np.float32((step - 1) * 0.5)
    rows = 0
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
            actual = np.float32(level[lo + i] * step) + middle
            if keep[lo + i]:
                for p in range(INPUTS):
                    xs[rows, p] = x[p]
                centre = mu[PREDICTORS - 1]
                for p in range(PREDICTORS):
                    mus[rows, p] = mu[p] - centre
                ys[rows] = actual - centre
                rows += 1
            inverse[r0, PAD + i] = q / max(actual + off, np.float32(1.0))
            note_errors(actual, mu, error0, error[r0, PAD + i])
        close_ring(azimuth[r0], inverse[r0], error[r0], m)
    return rows
