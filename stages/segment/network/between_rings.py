"""Pixels between the rings of a sensor that has fewer of them than the image has rows, or has them elsewhere.

The network has seen images without such gaps and takes them for edges. Between two rings that see one surface it goes
on as a plane does, along which 1/range is linear; between two that do not, each ring goes on half of the way.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.segment.network.range_image import HEIGHT, RANGE, X, Y, Z

F32 = NDArray[np.float32]
I32 = NDArray[np.int32]

_FULL = 0.75  # share of the pixels between a column's highest and lowest return, in the middle of all columns
_ROWS = 12  # that lie between two rings at most
_COLUMNS = 4  # that lie between two firings at most
_GROUND = 0.3  # metres above the ground; rings on it are far apart
_SURFACE, _SURFACE_BY_RANGE = 0.3, 0.15  # metres between rings on one surface, and for every metre of range


def has_gaps(index: I32) -> bool:
    """Tell whether rings or firings are farther apart than pixels, given the point ``(H, W)`` that each pixel shows; -1 none."""
    return bool(_fullness(index) < _FULL) or _firing_step(index) > 1


@njit(cache=True)
def _fullness(index: I32) -> float:
    rows, columns = index.shape
    shares = np.ones(columns + 1)
    used = 0
    for b in range(columns):
        first, last, seen = rows, 0, 0
        for a in range(rows):
            if index[a, b] >= 0:
                first, last, seen = min(first, a), a, seen + 1
        if seen > 1:
            shares[used] = seen / (last - first + 1)
            used += 1
    return np.median(shares[: max(used, 1)])


@njit(cache=True)
def _firing_step(index: I32) -> int:
    """Return the number of columns from one return of a row to the next that most are apart."""
    rows, columns = index.shape
    apart = np.zeros(_COLUMNS + 1, np.int64)
    for a in range(rows):
        last = -columns
        for b in range(columns):
            if index[a, b] >= 0:
                if b - last <= _COLUMNS:
                    apart[b - last] += 1
                last = b
    return int(np.argmax(apart))


def fill_between_rings(planes: F32, index: I32) -> None:
    """Fill in planes ``(6, H, W)`` and the point ``(H, W)`` that each pixel shows, which is the nearer of the two around; -1 none."""
    _fill_rows(planes, index, min(_firing_step(index) + 1, _COLUMNS))  # and one more, where a few are
    _fill_columns(planes, index)


@njit(cache=True)
def _one_surface(planes: F32, one: tuple[int, int], other: tuple[int, int]) -> bool:
    near, far = planes[RANGE, one[0], one[1]], planes[RANGE, other[0], other[1]]
    if abs(near - far) <= _SURFACE + _SURFACE_BY_RANGE * min(near, far):
        return True
    return max(planes[HEIGHT, one[0], one[1]], planes[HEIGHT, other[0], other[1]]) < _GROUND


@njit(cache=True)
def _between(
    planes: F32, index: I32, one: tuple[int, int], other: tuple[int, int], share: float, at: tuple[int, int]
) -> None:
    """Fill a pixel that lies a ``share`` of the way from one to the other."""
    nearest = one if share < 0.5 else other
    index[at] = index[nearest]
    weight = 0.0 if share < 0.5 else 1.0
    if _one_surface(planes, one, other):
        near, far = planes[RANGE, one[0], one[1]], planes[RANGE, other[0], other[1]]
        weight = share * near / (share * near + (1.0 - share) * far)
    for k in range(len(planes)):
        planes[k, at[0], at[1]] = (1.0 - weight) * planes[k, one[0], one[1]] + weight * planes[
            k, other[0], other[1]
        ]
    x, y, z = planes[X, at[0], at[1]], planes[Y, at[0], at[1]], planes[Z, at[0], at[1]]
    planes[RANGE, at[0], at[1]] = np.sqrt(x * x + y * y + z * z)


@njit(cache=True)
def _fill_rows(planes: F32, index: I32, step: int) -> None:
    """Fill between returns of a row that are up to ``step`` columns apart."""
    rows, columns = index.shape
    for a in range(rows):
        seen = np.flatnonzero(index[a] >= 0)
        for k in range(len(seen)):
            left, right = seen[k - 1], seen[k]
            apart = (right - left) % columns
            if 1 < apart <= step:
                for b in range(1, apart):
                    _between(planes, index, (a, left), (a, right), b / apart, (a, (left + b) % columns))


@njit(cache=True)
def _fill_columns(planes: F32, index: I32) -> None:
    rows, columns = index.shape
    for b in range(columns):
        above = -1
        for a in range(rows):
            if index[a, b] < 0:
                continue
            if above >= 0 and a - above <= _ROWS:
                for k in range(above + 1, a):
                    _between(planes, index, (above, b), (a, b), (k - above) / (a - above), (k, b))
            above = a
