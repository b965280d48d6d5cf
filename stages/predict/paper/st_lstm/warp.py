"""A range image seen from the next scan's place: a triangle mesh, moved and drawn again.

Neighbouring returns span triangles; each is carried by the motion and drawn into the new grid, where the
inverse range is linear over it. Triangles across an edge of depth are left out, the nearest surface wins, and
cells that no triangle covers take the nearest return that falls into them. Float64 ``+ - * / sqrt`` in a fixed
order, so both ends of an archive get the same millimetres.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.schemas.grid import COLUMNS, ROWS
from salpcc.stages.ingest.paper_grid import FIELD, UP
from salpcc.stages.lattice.trig import PI, arctan2, sin_cos
from salpcc.stages.lattice.untwist import _rotate as rotate

F64 = NDArray[np.float64]
Image = NDArray[np.int32]

NOTHING, FILLED, NEAREST, COVERED = 0, 1, 2, 3
_EDGE = 1.15  # ranges of one triangle's corners differ less than that, as a factor
_ACROSS = 3  # columns a triangle may span
_DOWN = 2  # rows
_FARTHEST_FILL = 16  # columns
CENTRES: F64 = UP - (np.arange(ROWS) + 0.5) / ROWS * FIELD


@njit(cache=True, error_model="numpy")
def pose_of(motion: F64) -> F64:
    """Return ``(3, 4)``, the matrix of ``P' = R(w) P + v``."""
    pose = np.empty((3, 4))
    for axis in range(3):
        x, y, z = rotate(
            1.0 if axis == 0 else 0.0,
            1.0 if axis == 1 else 0.0,
            1.0 if axis == 2 else 0.0,
            motion[3],
            motion[4],
            motion[5],
        )
        pose[0, axis] = x
        pose[1, axis] = y
        pose[2, axis] = z
        pose[axis, 3] = motion[axis]
    return pose


@njit(cache=True, error_model="numpy")
def after(second: F64, first: F64) -> F64:
    """Return the pose that carries by ``first``, then by ``second``."""
    out = np.empty((3, 4))
    for i in range(3):
        for j in range(4):
            total = second[i, 3] if j == 3 else 0.0
            for k in range(3):
                total += second[i, k] * first[k, j]
            out[i, j] = total
    return out


@njit(cache=True, error_model="numpy")
def _carry(image: Image, pose: F64, elevation: F64) -> F64:
    """Return ``(64, 2000, 3)``: row and column coordinates in the new grid, inverse range (0: empty)."""
    placed = np.zeros((ROWS, COLUMNS, 3))
    turn = np.empty((COLUMNS, 2))
    for column in range(COLUMNS):
        turn[column, 0], turn[column, 1] = sin_cos((1.0 - 2.0 * (column + 0.5) / COLUMNS) * PI)
    for row in range(ROWS):
        up, flat = sin_cos(elevation[row])
        for column in range(COLUMNS):
            if image[row, column] <= 0:
                continue
            reach = image[row, column] * 0.001
            x = reach * flat * turn[column, 1]
            y = reach * flat * turn[column, 0]
            z = reach * up
            a = pose[0, 0] * x + pose[0, 1] * y + pose[0, 2] * z + pose[0, 3]
            b = pose[1, 0] * x + pose[1, 1] * y + pose[1, 2] * z + pose[1, 3]
            c = pose[2, 0] * x + pose[2, 1] * y + pose[2, 2] * z + pose[2, 3]
            far = a * a + b * b
            if far + c * c < 1e-6:
                continue
            placed[row, column, 0] = (UP - arctan2(c, np.sqrt(far))) / FIELD * ROWS - 0.5
            placed[row, column, 1] = (1.0 - arctan2(b, a) / PI) * 0.5 * COLUMNS - 0.5
            placed[row, column, 2] = 1.0 / np.sqrt(far + c * c)
    return placed


@njit(cache=True, error_model="numpy")
def _triangle(drawn: F64, target: F64, a: F64, b: F64, c: F64) -> None:
    """Draw one triangle of (row, column, inverse range) corners; nearest wins."""
    high = max(a[2], b[2], c[2])
    if high > min(a[2], b[2], c[2]) * _EDGE:
        return
    half = 0.5 * COLUMNS
    bc = b[1] - a[1]
    cc = c[1] - a[1]
    bc += COLUMNS if bc < -half else (-COLUMNS if bc > half else 0)
    cc += COLUMNS if cc < -half else (-COLUMNS if cc > half else 0)
    left, right = min(0.0, bc, cc) + a[1], max(0.0, bc, cc) + a[1]
    br = b[0] - a[0]
    cr = c[0] - a[0]
    area = br * cc - cr * bc
    if area == 0.0 or right - left > 40.0:
        return
    top = min(0.0, br, cr) + a[0]
    bottom = max(0.0, br, cr) + a[0]
    for row in range(max(0, int(np.floor(top))), min(ROWS - 1, int(np.ceil(bottom))) + 1):
        r = target[row] - a[0]
        for column in range(int(np.ceil(left)), int(np.floor(right)) + 1):
            t = column - a[1]
            u = (r * cc - cr * t) / area
            v = (br * t - r * bc) / area
            if u >= 0.0 and v >= 0.0 and u + v <= 1.0:
                inverse = a[2] + u * (b[2] - a[2]) + v * (c[2] - a[2])
                place = column % COLUMNS
                drawn[row, place] = max(drawn[row, place], inverse)


@njit(cache=True, error_model="numpy")
def _draw(placed: F64, target: F64) -> tuple[F64, F64]:
    """Return inverse ranges ``(64, 2000)``: of the mesh, and of the nearest return in each cell."""
    mesh = np.zeros((ROWS, COLUMNS))
    nearest = np.zeros((ROWS, COLUMNS))
    for row in range(ROWS):
        for column in range(COLUMNS):
            here = placed[row, column]
            if here[2] == 0.0:
                continue
            r = int(np.floor(here[0] + 0.5))
            c = int(np.floor(here[1] + 0.5)) % COLUMNS
            if 0 <= r < ROWS and here[2] > nearest[r, c]:
                nearest[r, c] = here[2]
            right = -1
            for gap in range(1, _ACROSS + 1):
                if placed[row, (column + gap) % COLUMNS, 2] > 0.0:
                    right = (column + gap) % COLUMNS
                    break
            below = -1
            for gap in range(1, _DOWN + 1):
                if row + gap < ROWS and placed[row + gap, column, 2] > 0.0:
                    below = row + gap
                    break
            if right < 0 or below < 0:
                continue
            _triangle(mesh, target, here, placed[row, right], placed[below, column])
            if placed[below, right, 2] > 0.0:
                _triangle(mesh, target, placed[below, right], placed[row, right], placed[below, column])
    return mesh, nearest


@njit(cache=True, error_model="numpy")
def _settle(mesh: F64, nearest: F64) -> tuple[Image, NDArray[np.uint8]]:
    """Return millimetres and where each comes from; empty cells take the nearest one of their row."""
    ranges = np.zeros((ROWS, COLUMNS), np.int32)
    status = np.zeros((ROWS, COLUMNS), np.uint8)
    for row in range(ROWS):
        for column in range(COLUMNS):
            inverse = mesh[row, column] if mesh[row, column] > 0.0 else nearest[row, column]
            if inverse > 0.0:
                ranges[row, column] = min(int(1000.0 / inverse + 0.5), 1 << 20)
                status[row, column] = COVERED if mesh[row, column] > 0.0 else NEAREST
    for row in range(ROWS):
        for column in range(COLUMNS):
            if status[row, column] >= NEAREST:
                continue
            for gap in range(1, _FARTHEST_FILL + 1):
                # Of two at the same distance the farther one: what an edge uncovers is background.
                left = column - gap
                right = (column + gap) % COLUMNS
                found = max(
                    ranges[row, left] if status[row, left] >= NEAREST else 0,
                    ranges[row, right] if status[row, right] >= NEAREST else 0,
                )
                if found > 0:
                    ranges[row, column] = found
                    status[row, column] = FILLED
                    break
    for _ in range(3):
        for row in range(ROWS):
            for column in range(COLUMNS):
                if ranges[row, column] == 0:
                    if row > 0 and ranges[row - 1, column] > 0:
                        ranges[row, column] = ranges[row - 1, column]
                        status[row, column] = FILLED
                    elif row + 1 < ROWS and ranges[row + 1, column] > 0:
                        ranges[row, column] = ranges[row + 1, column]
                        status[row, column] = FILLED
    return ranges, status


def warp(image: Image, pose: F64, elevation: F64 | None = None) -> tuple[Image, NDArray[np.uint8]]:
    """Return ``image`` as seen after the motion.

    Args:
        image: ``(64, 2000)`` int32, millimetres, 0 where empty.
        pose: ``(3, 4)`` float64 of :func:`pose_of`.
        elevation: ``(64,)`` radians, where the rows look; by default their centres.

    Returns:
        ``(64, 2000)`` int32 millimetres (0: nothing near) and uint8, one of :data:`NOTHING`,
        :data:`FILLED`, :data:`NEAREST`, :data:`COVERED`.
    """
    rows = CENTRES if elevation is None else elevation
    target = (UP - rows) / FIELD * ROWS - 0.5
    return _settle(*_draw(_carry(image, pose, rows), target))
