"""Motion between two range images: projective point-to-plane ICP. The encoder finds it, the decoder is told.

A motion ``(v, w)`` carries the points of one frame into the coordinates of the next: ``P' = R(w) P + v``.
It is sent in whole units, so that both sides have the same.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.schemas.grid import COLUMNS, ROWS
from salpcc.stages.ingest.paper_grid import cell_of

UNITS = np.array([1e-3, 1e-3, 1e-3, 1e-5, 1e-5, 1e-5])  # metres, radians
LIMIT = 32767  # of the units, 32 m or 19 degrees
_ROUNDS = 24
_EVERY = 7  # of the filled cells
_FEWEST = 200
_NEAR, _FAR = 2.5, 70.0  # metres


@njit(cache=True, error_model="numpy")
def _normal(points: NDArray[np.float64], reach: NDArray[np.float64], cell: int) -> NDArray[np.float64]:
    """Unit normal at a cell from its neighbours two columns and one row away; zero where they do not belong."""
    normal = np.zeros(3)
    row, column = cell // COLUMNS, cell % COLUMNS
    if row == 0 or row == ROWS - 1:
        return normal
    left = row * COLUMNS + (column - 2) % COLUMNS
    right = row * COLUMNS + (column + 2) % COLUMNS
    up, down = cell - COLUMNS, cell + COLUMNS
    r = reach[cell]
    for other in (left, right, up, down):
        if reach[other] == 0.0 or abs(reach[other] - r) > 0.15 * r:
            return normal
    a = points[right] - points[left]
    b = points[down] - points[up]
    normal[0] = a[1] * b[2] - a[2] * b[1]
    normal[1] = a[2] * b[0] - a[0] * b[2]
    normal[2] = a[0] * b[1] - a[1] * b[0]
    length = np.sqrt((normal * normal).sum())
    return normal / length if length > 0.0 else normal


@njit(cache=True, error_model="numpy")
def _equations(
    moving: NDArray[np.float64],
    fixed: NDArray[np.float64],
    reach: NDArray[np.float64],
    turn: NDArray[np.float64],
    way: NDArray[np.float64],
    gate: float,
) -> tuple[int, NDArray[np.float64], NDArray[np.float64]]:
    """Normal equations of one Gauss-Newton step, weighted down beyond a third of the gate."""
    h, g = np.zeros((6, 6)), np.zeros(6)
    used = 0
    j = np.zeros(6)
    for i in range(len(moving)):
        p = turn @ moving[i] + way
        cell = cell_of(p[0], p[1], p[2])
        if reach[cell] == 0.0:
            continue
        normal = _normal(fixed, reach, cell)
        off = fixed[cell] - p
        distance = (normal * off).sum()
        if (
            (normal * normal).sum() == 0.0
            or abs(distance) > gate
            or (off * off).sum() > 4.0 * gate * gate + 0.25
        ):
            continue
        j[0], j[1], j[2] = normal[0], normal[1], normal[2]
        j[3] = p[1] * normal[2] - p[2] * normal[1]
        j[4] = p[2] * normal[0] - p[0] * normal[2]
        j[5] = p[0] * normal[1] - p[1] * normal[0]
        scaled = 3.0 * distance / gate
        weight = 1.0 / (1.0 + scaled * scaled)
        used += 1
        for u in range(6):
            g[u] += weight * j[u] * distance
            for v in range(6):
                h[u, v] += weight * j[u] * j[v]
    return used, h, g


def find_motion(
    before: NDArray[np.float64],
    after: NDArray[np.float64],
    start: NDArray[np.float64] | None = None,
) -> NDArray[np.int32] | None:
    """Return the motion from one frame to the next in whole units ``(6,)``, or None where none is found.

    Args:
        before, after: points ``(64 * 2000, 3)`` of the frames by cell, zeros where a cell is empty.
        start: ``(6,)`` a guess.
    """
    reach = np.sqrt((after * after).sum(axis=1))
    lengths = np.sqrt((before * before).sum(axis=1))
    moving = np.ascontiguousarray(before[(lengths > _NEAR) & (lengths < _FAR)][::_EVERY])
    motion = np.zeros(6) if start is None else start
    turn, way = rotation(motion[3:]), motion[:3].copy()
    for number in range(_ROUNDS):
        gate = max(1.5 * 0.8**number, 0.15)
        used, h, g = _equations(moving, after, reach, turn, way, gate)
        if used < _FEWEST:
            return None
        step = np.linalg.lstsq(h + 1e-9 * np.eye(6), g, rcond=None)[0]
        small = rotation(step[3:])
        turn, way = small @ turn, small @ way + step[:3]
        if gate == 0.15 and np.abs(step).max() < 1e-4:
            break
    units = np.rint(np.concatenate([way, _vector(turn)]) / UNITS)
    return units.astype(np.int32) if np.abs(units).max() <= LIMIT else None


def rotation(w: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rotation matrix ``(3, 3)`` of a rotation vector."""
    angle = float(np.sqrt((w * w).sum()))
    x, y, z = w
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    a = np.sinc(angle / np.pi)
    b = 0.5 * np.sinc(angle / (2 * np.pi)) ** 2
    return np.asarray(np.eye(3) + a * cross + b * cross @ cross)


def _vector(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rotation vector of a rotation by less than half a turn; inverse of :func:`rotation`."""
    axis = (
        np.array([matrix[2, 1] - matrix[1, 2], matrix[0, 2] - matrix[2, 0], matrix[1, 0] - matrix[0, 1]]) / 2
    )
    sine = float(np.sqrt((axis * axis).sum()))
    angle = float(np.arctan2(sine, (np.trace(matrix) - 1) / 2))
    return axis * (angle / sine if sine > 0 else 1.0)
