"""Residuals of a range image: eq. (11) for ground, eq. (19) for the rest, and back.

A cell's prediction is the first there is of: the plane of its region, moved by what it missed at the ground cell
before in the row, if it is ground; the frame predicted from those before; its neighbours in the frame (left, above,
and their gradient, as in LOCO-I), which serve the first frame of a GOP and the holes of the predicted one.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.schemas.grid import COLUMNS, ROWS

_MOST_BITS = 27  # of a residual
_START = 10000  # a level where nothing at all is known


@njit(cache=True, error_model="numpy")
def _from_neighbours(level: NDArray[np.int32], row: int, column: int, last: int) -> int:
    """Median of left, above and left + above - above left; ``last`` is the filled column before, -1: none."""
    up = np.int64(0)
    if row > 0:
        for near in (column, column - 1, (column + 1) % COLUMNS):
            if near >= 0 and level[row - 1, near] > 0:
                up = np.int64(level[row - 1, near])
                break
    if last < 0:
        return int(up) if up > 0 else _START
    left = np.int64(level[row, last])
    corner = np.int64(level[row - 1, last]) if row > 0 else np.int64(0)
    if up == 0 or corner == 0:
        return int(left)
    return int(min(max(min(left, up), left + up - corner), max(left, up)))


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
        off = np.int64(
            0
        )  # of the plane at the last ground cell: what a plane misses, it misses next door as well
        for column in range(COLUMNS):
            if not filled[row, column]:
                continue
            on_plane = ground[row, column] and plane[row, column] > 0
            if on_plane:
                predicted = np.int64(plane[row, column]) + off
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
            if on_plane:
                off = np.int64(level[row, column]) - np.int64(plane[row, column])
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


def ground_first(ground: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return the order ``(M,)`` in which residuals are coded: those of ground, then the others, row by row."""
    return np.argsort(~ground, kind="stable")


def to_symbols(residual: NDArray[np.int32]) -> tuple[bytes, bytes]:
    """Lay residuals out for a coder of bytes: a symbol each, and the bits below it, which are as good as random.

    A residual of k bits has the symbol ``1 + 4 (k - 1) + 2 (its second bit) + (is it negative)``, 0 has 0; its last
    ``k - 2`` bits are packed, least significant first. *Why:* symbols follow how rough the scene is, and a coder of
    bytes sees that only where noise does not hide it; PPMd needs 4 to 8 % fewer bits than with planes of bytes.
    """
    magnitude = np.abs(residual.astype(np.int64))
    size = _bits_of(magnitude)
    second = np.where(size >= 2, (magnitude >> np.maximum(size - 2, 0)) & 1, 0)
    symbol = np.where(size > 0, 1 + 4 * (size - 1) + 2 * second + (residual < 0), 0)
    place, count = _places(size)
    bits = np.zeros(count, np.uint8)
    for bit in range(int(size.max(initial=0)) - 2):
        has = size - 2 > bit
        bits[place[has] + bit] = (magnitude[has] >> bit) & 1
    return symbol.astype(np.uint8).tobytes(), np.packbits(bits).tobytes()


def from_symbols(symbols: bytes, rest: bytes) -> tuple[NDArray[np.int32], bool]:
    """Return the residuals and whether there can be such; inverse of :func:`to_symbols`."""
    symbol = np.frombuffer(symbols, np.uint8).astype(np.int64)
    code = np.maximum(symbol - 1, 0)
    size = np.where(symbol > 0, code // 4 + 1, 0)
    place, count = _places(size)
    if len(rest) != -(-count // 8) or size.max(initial=0) > _MOST_BITS:
        return np.zeros(0, np.int32), False
    bits = np.unpackbits(np.frombuffer(rest, np.uint8), count=count)
    magnitude = np.where(size > 1, (2 | code // 2 % 2) << np.maximum(size - 2, 0), size)
    for bit in range(int(size.max(initial=0)) - 2):
        has = size - 2 > bit
        magnitude[has] |= bits[place[has] + bit].astype(np.int64) << bit
    return np.where(code % 2 == 1, -magnitude, magnitude).astype(np.int32), True


def _bits_of(magnitude: NDArray[np.int64]) -> NDArray[np.int64]:
    """Number of bits of each magnitude."""
    return np.searchsorted(1 << np.arange(_MOST_BITS, dtype=np.int64), magnitude, side="right")


def _places(size: NDArray[np.int64]) -> tuple[NDArray[np.int64], int]:
    """Where the packed bits of each residual start, and how many there are."""
    ends = np.cumsum(np.maximum(size - 2, 0))
    return ends - np.maximum(size - 2, 0), int(ends[-1]) if len(ends) else 0
