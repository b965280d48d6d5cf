"""The sweep before, seen from the current one: its decoded returns moved by the known motion.

Both sweeps were compensated to their own middle, by motions ``(v, w)`` per turn that the archive holds, so half
of each lies between the two middles; from there the current motion is undone, as if the current sensor had
measured the points. They are then sorted into rows by the laser whose cone is nearest, by azimuth within
a row: several depths at an occlusion stand side by side. Decoders repeat this: see :mod:`.range_features`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.schemas.sweep import Sweep
from salpcc.stages.lattice.lattice import laser_constants, model_point
from salpcc.stages.lattice.sensor_model import SensorModel
from salpcc.stages.lattice.trig import TWO_PI, arctan2, sin_cos, turn_tables
from salpcc.stages.lattice.untwist import BLOCK, Motion, forward, inverse, inverse_in_two, moved
from salpcc.stages.predict.hundredths import intensity_levels
from salpcc.stages.predict.ring_rows import PAD, SLACK
from salpcc.stages.predict.sweep_walk import TICKS

UNKNOWN_INTENSITY = 25

F32 = NDArray[np.float32]
_NOWHERE = 1e300  # the apex of a cone that nothing is near


class WarpedSweep(NamedTuple):
    """A sweep as another one sees it, in rows like rings, each at ``[PAD, PAD + number)``, margins cyclic; kernels take it.

    Attributes:
        number: ``(L,)`` int64 points of each row.
        azimuth: ``(L, size)`` in ticks, without lever arm, rising; inverse: 1 / rho', 1/m; height: z / rho';
        intensity: hundredths; cones: of the sensor, see :func:`cones`.
    """

    number: NDArray[np.int64]
    azimuth: F32
    inverse: F32
    height: F32
    intensity: F32
    cones: F32


@njit(cache=True, error_model="numpy", nogil=True)
def _seen(laser, tick, count, step, sensor, motion_before, motion, ends):  # type: ignore[no-untyped-def]
    """Row and bits of the azimuth in one number (-1 where it is not seen), and ``(3, M)`` azimuth in ticks, inverse range, height of each return of the sweep before.

    ``sensor`` are its parameters, the size of a count and the tables of a turn; ``ends`` apex and tangent of the cones,
    ``(2, L + 2)``, with one that nothing is near at either end.
    """
    n = len(laser)
    key = np.empty(n, np.int64)
    seen = np.empty((3, n), np.float32)
    azimuth, inverses, height = seen[0], seen[1], seen[2]
    bits = azimuth.view(np.int32)
    parameters, count_size, sines, cosines = sensor
    ticks = len(sines)
    apex, tangent = ends[0], ends[1]
    constants = laser_constants(parameters)
    m0 = (
        motion_before[0],
        motion_before[1],
        motion_before[2],
        motion_before[3],
        motion_before[4],
        motion_before[5],
    )
    m = (motion[0], motion[1], motion[2], motion[3], motion[4], motion[5])
    block = np.empty((8, BLOCK))
    x, y, z, qx, qy, qz = block[0], block[1], block[2], block[3], block[4], block[5]
    rho, off = block[6], block[7]
    known = np.empty(BLOCK, np.bool_)
    row = np.empty(BLOCK, np.int32)
    middle = (step - 1) / 2
    for start in range(0, n, BLOCK):
        size = min(BLOCK, n - start)
        for i in range(size):
            k, t = laser[start + i], tick[start + i] % ticks
            c = np.float64(count[start + i]) * step + middle
            x[i], y[i], z[i] = model_point(t, c, parameters[k], constants[k], count_size, sines, cosines)
        for i in range(size):
            px, py, pz = forward(x[i], y[i], z[i], m0)
            px, py, pz = _later(px, py, pz, m0)
            x[i], y[i], z[i] = _later(px, py, pz, m)
        for i in range(size):
            qx[i], qy[i], qz[i], known[i] = inverse_in_two(x[i], y[i], z[i], m)
        for i in range(size):
            rho2 = x[i] * x[i] + y[i] * y[i]
            if not known[i] and 0.25 < rho2 < 1e8:
                qx[i], qy[i], qz[i] = inverse(x[i], y[i], z[i], motion, 0)
            x[i] = rho2
        # Each loop touches few arrays: of many, the compiler does not find out that they lie apart.
        for i in range(size):
            rho[i] = np.sqrt(qx[i] * qx[i] + qy[i] * qy[i])
        for i in range(size):
            turn = arctan2(qy[i], qx[i]) * (TICKS / TWO_PI)
            azimuth[start + i] = turn + TICKS if turn < 0.0 else turn + 0.0  # no -0.0
        for i in range(size):
            inverses[start + i] = 1.0 / rho[i]
        for i in range(size):
            height[start + i] = qz[i] / rho[i]
        for i in range(size):
            known[i] = (x[i] > 0.25) & (x[i] < 1e8) & (rho[i] > 0.5) & (rho[i] < 1e4)
        for i in range(size):
            row[i] = laser[start + i]
            k = np.uint32(row[i] + 1)
            off[i] = abs(qz[i] - apex[k] - rho[i] * tangent[k])
        for i in range(size):
            off[i] = off[i] if known[i] else -1.0
        for way in (-1, 1):  # to the laser whose cone is nearest, step by step
            moves = np.int32(1)
            while moves > 0:
                moves = np.int32(0)
                for i in range(size):
                    k = np.uint32(row[i] + 1 + way)
                    next_off = abs(qz[i] - apex[k] - rho[i] * tangent[k])
                    nearer = next_off < off[i]
                    off[i] = next_off if nearer else off[i]
                    row[i] += np.int32(way if nearer else 0)
                    moves += np.int32(1 if nearer else 0)
        for i in range(size):
            key[start + i] = np.int64(row[i]) << 32 | bits[start + i] if known[i] else -1
    return key, seen


@njit(cache=True, error_model="numpy", inline="always")
def _later(x: float, y: float, z: float, m: Motion) -> tuple[float, float, float]:
    """Move a point into the frame that the vehicle has half a turn later.

    The sensor turns clockwise, so the turn's fraction ``s``, an azimuth, falls as time goes on.
    """
    return moved(x, y, z, 0.5, m)


@njit(cache=True, error_model="numpy", nogil=True)
def _rows(order, key, seen, intensity, lasers):  # type: ignore[no-untyped-def]
    """Lay out points in ``order`` of their keys; fill the margins."""
    number = np.zeros(lasers, np.int64)
    unseen = 0
    for i in range(len(key)):
        if key[i] < 0:
            unseen += 1
        else:
            number[key[i] >> 32] += 1
    rows = np.zeros((4, lasers, np.max(number) + 2 * PAD + SLACK), np.float32)
    fill = np.full(lasers, PAD)
    for i in order[unseen:]:
        k = key[i] >> 32
        for c in range(3):
            rows[c, k, fill[k]] = seen[c, i]
        rows[3, k, fill[k]] = intensity[i]
        fill[k] += 1
    for k in range(lasers):
        m = number[k]
        if m == 0:
            continue
        for p in range(PAD):
            left, right = PAD + m - 1 - p % m, PAD + p % m
            for c in range(4):
                rows[c, k, PAD - 1 - p] = rows[c, k, left]
                rows[c, k, PAD + m + p] = rows[c, k, right]
            turns = np.float32(1 + p // m) * np.float32(TICKS)
            rows[0, k, PAD - 1 - p] -= turns
            rows[0, k, PAD + m + p] += turns
    return number, rows


@njit(cache=True, error_model="numpy")
def _cones(parameters: NDArray[np.float64]) -> F32:
    lasers = len(parameters)
    out = np.zeros((lasers, 3), np.float32)
    for k in range(lasers):
        sine, cosine = sin_cos(parameters[k, 0])
        out[k, 0] = parameters[k, 1]
        out[k, 1] = sine / cosine
    for k in range(lasers):
        a, b = max(k - 1, 0), min(max(k, 1), lasers - 1)
        out[k, 2] = np.float32(1.0) / max(out[a, 1] - out[b, 1], np.float32(1e-3))
    return out


def cones(sensor: SensorModel) -> F32:
    """Return ``(L, 3)``: apex in metres, tangent of the elevation, 1 / its distance to the laser above."""
    return _cones(sensor.parameters)


def warp(before: Sweep | None, motion: NDArray[np.float64] | None, sensor: SensorModel) -> WarpedSweep:
    """Move the returns of the sweep before into the lattice of a sweep compensated with ``motion``.

    Without a sweep before, or where one of the two motions is not known, the rows are empty.
    """
    if before is None or before.motion is None or motion is None:
        none = np.zeros((sensor.n_lasers, 2 * PAD + SLACK), np.float32)
        return WarpedSweep(np.zeros(sensor.n_lasers, np.int64), none, none, none, none, cones(sensor))
    values = intensity_levels(before.intensity)
    if values is None:
        values = np.full(len(before.laser), UNKNOWN_INTENSITY, np.uint8)
    of_lasers = cones(sensor)
    ends = np.full((2, sensor.n_lasers + 2), [[_NOWHERE], [0.0]])
    ends[:, 1:-1] = sensor.parameters[:, 1], of_lasers[:, 1]
    of_sensor = (sensor.parameters, sensor.count, *turn_tables(sensor.ticks_per_turn))
    key, seen = _seen(
        before.laser, before.tick, before.count, before.step, of_sensor, before.motion, motion, ends
    )
    # Bits of floats that are not negative rise with them.
    number, rows = _rows(np.argsort(key, kind="stable"), key, seen, values, sensor.n_lasers)
    return WarpedSweep(number, rows[0], rows[1], rows[2], rows[3], of_lasers)
