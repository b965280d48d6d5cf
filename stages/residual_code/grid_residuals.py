"""Residuals of a range image: eq. (11) for ground, eq. (19) for the rest, and back.

A cell's prediction is the first there is of: the plane of its region, if it is ground; the frame predicted from
those before; its neighbours in the frame (left, above, and their gradient, as in LOCO-I), which serve the first
frame of a GOP and the holes of the predicted one.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.schemas.grid import COLUMNS, ROWS

_START = 10000  # a level where nothing at all is known


@njit(cache=True, error_model="numpy")
def _from_neighbours(level: NDArray[np.int32], row: int, column: int, last: int) -> int:
    """Median of left, above and left + above - above left; ``last`` is the filled column before, -1: none."""
    up = 0
    if row > 0:
        for near in (column, column - 1, (column + 1) % COLUMNS):
            if near >= 0 and level[row - 1, near] > 0:
                up = np.int64(level[row - 1, near])
                break
    if last < 0:
        return up if up > 0 else _START
    left = np.int64(level[row, last])
    corner = np.int64(level[row - 1, last]) if row > 0 else 0
    if up == 0 or corner == 0:
        return left
    return min(max(min(left, up), left + up - corner), max(left, up))


@njit(cache=True, error_model="numpy")
def _walk(
    decoding: bool,
    level: NDArray[np.int32],
    filled: NDArray[np.bool_],
    ground: NDArray[np.bool_],
    plane: NDArray[np.int32],
    frame: NDArray[np.int32],
    residual: NDArray[np.int32],
) -> bool:
    """Turn levels into residuals or back, cell by cell; tells whether all levels were possible ones."""
    place = 0
    for row in range(ROWS):
        last = -1
        for column in range(COLUMNS):
            if not filled[row, column]:
                continue
            if ground[row, column] and plane[row, column] > 0:
                predicted = np.int64(plane[row, column])
            elif frame[row, column] > 0:
                predicted = np.int64(frame[row, column])
            else:
                predicted = np.int64(_from_neighbours(level, row, column, last))
            if decoding:
                value = predicted + residual[place]
                if value < 1 or value >= 1 << 24:
                    return False
                level[row, column] = value
            else:
                residual[place] = level[row, column] - predicted
            place += 1
            last = column
    return True


def residuals(
    level: NDArray[np.int32], ground: NDArray[np.bool_], plane: NDArray[np.int32], frame: NDArray[np.int32]
) -> NDArray[np.int32]:
    """Return the residual of each filled cell, row by row.

    Args:
        level: ``(64, 2000)``, 0 empty.
        ground: which cells are ground.
        plane, frame: levels predicted by planes and from the frames before, 0 for none.
    """
    filled = level > 0
    out = np.empty(int(filled.sum()), np.int32)
    _walk(False, level, filled, ground, plane, frame, out)
    return out


def from_residuals(
    residual: NDArray[np.int32],
    filled: NDArray[np.bool_],
    ground: NDArray[np.bool_],
    plane: NDArray[np.int32],
    frame: NDArray[np.int32],
) -> tuple[NDArray[np.int32], bool]:
    """Return the level image and whether it can be one; inverse of :func:`residuals`."""
    level = np.zeros(filled.shape, np.int32)
    sound = _walk(True, level, filled, ground, plane, frame, residual)
    return level, bool(sound)


def to_bytes(residual: NDArray[np.int32]) -> bytes:
    """Lay residuals out for a coder of bytes: zig-zag (0, -1, 1, -2, ...), then all high bytes, middle, low."""
    zigzag = (residual << 1) ^ (residual >> 31)
    return b"".join(((zigzag >> shift) & 255).astype(np.uint8).tobytes() for shift in (24, 16, 8, 0))


def from_bytes(data: bytes, n: int) -> NDArray[np.int32]:
    """Inverse of :func:`to_bytes` for ``n`` residuals."""
    planes = np.frombuffer(data, np.uint8).reshape(4, n).astype(np.uint32)
    zigzag = planes[0] << 24 | planes[1] << 16 | planes[2] << 8 | planes[3]
    return ((zigzag >> 1).astype(np.int32)) ^ -(zigzag & 1).astype(np.int32)
