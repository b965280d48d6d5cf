"""The order of points in a file: ring by ring, by azimuth of the point within a ring.

A sweep holds its returns in firing order (laser, tick). KITTI's files are sorted by the azimuth of
the point itself, which the lever arm turns by up to a degree at close range, so that returns of
neighbouring firings change places where the range jumps. The azimuth of the lattice point before it
was rounded to 1 mm gives the file's order back.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.lattice.trig import TWO_PI, arctan2
from salpcc.stages.lattice.untwist import BLOCK


@njit(cache=True, error_model="numpy", inline="always")
def azimuth_key(x: float, y: float) -> float:
    """Return the azimuth in [0, 2 pi] of a point, the same on every machine."""
    angle = arctan2(y, x)
    return angle + TWO_PI if angle < 0.0 else angle


@njit(cache=True, error_model="numpy", nogil=True)
def azimuth_keys(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return :func:`azimuth_key` of points ``(M, 3)``."""
    n = len(points)
    keys = np.empty(n)
    block = np.empty((2, BLOCK))
    x, y = block[0], block[1]
    for start in range(0, n, BLOCK):
        size = min(BLOCK, n - start)
        for i in range(size):
            x[i], y[i] = points[start + i, 0], points[start + i, 1]
        for i in range(size):
            keys[start + i] = azimuth_key(x[i], y[i])
    return keys


@njit(cache=True, nogil=True)
def file_order(laser: NDArray[np.uint8], keys: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return the permutation ``(M,)`` that sorts returns in firing order by (laser, key), stably.

    Insertion sort: the input is almost sorted.
    """
    order = np.arange(len(laser))
    for i in range(1, len(laser)):
        j = i
        while j > 0 and laser[order[j - 1]] == laser[i] and keys[order[j - 1]] > keys[i]:
            order[j] = order[j - 1]
            j -= 1
        order[j] = i
    return order


@njit(cache=True)
def in_order(laser: NDArray[np.integer[Any]], keys: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Mark a largest set of points, given in file order, that sorting by (laser, key) leaves in place.

    Lasers do not fall along the input.
    """
    n = len(laser)
    keep = np.ones(n, np.bool_)
    begin, falls = 0, False
    for i in range(1, n + 1):
        if i == n or laser[i] != laser[begin]:
            if falls:
                keep[begin:i] = _longest_rise(keys[begin:i])
            begin, falls = i, False
        else:
            falls |= keys[i] <= keys[i - 1]
    return keep


@njit(cache=True)
def _longest_rise(values: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Mark a longest strictly increasing subsequence (patience sorting)."""
    n = len(values)
    tails, tail_index, before = np.empty(n), np.empty(n, np.int64), np.full(n, -1, np.int64)
    length = 0
    for i in range(n):
        place = np.searchsorted(tails[:length], values[i])
        if place > 0:
            before[i] = tail_index[place - 1]
        tails[place], tail_index[place] = values[i], i
        length = max(length, place + 1)
    keep = np.zeros(n, np.bool_)
    i = tail_index[length - 1]
    while i >= 0:
        keep[i] = True
        i = before[i]
    return keep
