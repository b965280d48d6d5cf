"""What the network reads at each pixel: the tensors M_dep, M_coor and M_int of section IV, with geometry.

Beside range, coordinates and intensity there are range steps to the four neighbours, the height above
the ground and the surface normal: fifty labelled scans are too few to learn these from raw numbers.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.segment.network.bfloat16 import Numbers, put

F32 = NDArray[np.float32]
Units = NDArray[Any]  # unsigned whole numbers, moved as they are

DEPTH, COORDINATES, INTENSITY = 7, 9, 3
CHANNELS = DEPTH + COORDINATES + INTENSITY
_REACH = 3  # columns to either side that a normal is measured over; one is less than the range noise
_SOFT = 0.2  # metres; a step of this size is half of a large one
_LANES = 128  # pixels side by side
_WIDE = _LANES + 2 * _REACH
_X, _Y, _Z, _R, _I = (
    (3 * plane + 1) * _WIDE for plane in range(5)
)  # where a row of theirs lies between its neighbours


def pixel_features(planes: F32, circular: bool) -> F32:
    """Return features ``(19, H, W)`` float32 of range-image planes ``(6, H, W)``; 0 where there is no return.

    Args:
        circular: whether the last column is the first one's neighbour (whole turns, not crops).
    """
    return _features(planes, circular)


def folded_features(planes: F32, fold: int, side: int, out: Sequence[Numbers]) -> None:
    """Write the features of a whole turn, planes ``(6, H, W)``, into the images that the modalities see.

    Args:
        fold: columns that are channels of one pixel, one after the other for each feature.
        side: pixels repeated at both ends.
        out: images ``(H, W / fold + 2 side, C fold)`` for depth, coordinates and intensity.
    """
    row = np.empty((CHANNELS, planes.shape[2]), out[0].dtype)
    moved = math.gcd(fold, 8 // row.itemsize)  # numbers of a row that stay side by side
    unit = f"u{moved * row.itemsize}"
    _fold(planes, fold // moved, side, row, row.view(unit), *(image.view(unit) for image in out))


@njit(cache=True)
def _features(planes: F32, circular: bool) -> F32:
    _, rows, columns = planes.shape
    wide = _widened(planes, circular)
    out = np.empty((CHANNELS, rows, columns), np.float32)
    row = np.empty((CHANNELS, columns), np.float32)
    for i in range(rows):
        _row(planes, wide, i, row)
        out[:, i] = row
    return out


@njit(cache=True)
def _fold(
    planes: F32,
    fold: int,
    side: int,
    row: Numbers,
    units: Units,
    depth: Units,
    coordinates: Units,
    intensity: Units,
) -> None:
    wide = _widened(planes, True)
    found = np.empty(row.shape, np.float32)
    for i in range(planes.shape[1]):
        _row(planes, wide, i, found)
        put(found.ravel(), row.ravel())
        _fold_row(units[:DEPTH], fold, side, depth[i])
        _fold_row(units[DEPTH : DEPTH + COORDINATES], fold, side, coordinates[i])
        _fold_row(units[DEPTH + COORDINATES :], fold, side, intensity[i])


@njit(cache=True)
def _fold_row(row: Units, fold: int, side: int, out: Units) -> None:
    """Lay out the features ``(C, W)`` of a row as pixels ``(W / fold + 2 side, C fold)``."""
    pixels = row.shape[1] // fold
    for c in range(len(row)):
        for k in range(fold):
            for p in range(pixels):
                out[side + p, c * fold + k] = row[c, p * fold + k]
    out[:side] = out[pixels : pixels + side]
    out[side + pixels :] = out[side : 2 * side]


@njit(cache=True)
def _widened(planes: F32, circular: bool) -> F32:
    """Return x, y, z, range and intensity ``(5, H, W + 6)`` with the columns that normals reach for at both ends."""
    _, rows, columns = planes.shape
    out = np.empty((5, rows, columns + 2 * _REACH), np.float32)
    out[:, :, _REACH : _REACH + columns] = planes[:5]
    for k in range(_REACH):
        out[:, :, k] = planes[:5, :, columns - _REACH + k if circular else 0]
        out[:, :, _REACH + columns + k] = planes[:5, :, k if circular else columns - 1]
    return out


@njit(cache=True)
def _row(planes: F32, wide: F32, i: int, out: F32) -> None:
    """Compute the features ``(19, W)`` of row ``i``."""
    _, rows, columns = planes.shape
    seen = np.zeros(5 * 3 * _WIDE, np.float32)
    height, found = np.zeros(_LANES, np.float32), np.empty(CHANNELS * _LANES, np.float32)
    for start in range(0, columns, _LANES):
        here = min(_LANES, columns - start)
        for plane in range(5):
            for k, row in enumerate((max(i - 1, 0), i, min(i + 1, rows - 1))):
                at = (3 * plane + k) * _WIDE
                seen[at : at + here + 2 * _REACH] = wide[plane, row, start : start + here + 2 * _REACH]
        height[:here] = planes[5, i, start : start + here]
        for j in range(here):
            r = planes[3, i, start + j]
            out[0, start + j] = np.log(r) / 3.0 if r > 0 else 0.0
        _beside(seen, height, found)
        _normals(seen, found)
        _shine(seen, min(i, 1), min(rows - 1 - i, 1), found)
        for c in range(1, CHANNELS):
            out[c, start : start + here] = found[c * _LANES : c * _LANES + here]


# What follows sees some pixels of a row side by side: x, y, z, range, intensity, each of the row above, this one and the
# one below, with the columns around. Without branches, and all at fixed places, so that a compiler makes vectors of it.


@njit(cache=True, inline="always", error_model="numpy")
def _soft(step: float) -> float:
    return step / (_SOFT + abs(step))


@njit(cache=True, error_model="numpy")
def _beside(seen: F32, height: F32, out: F32) -> None:
    """Compute features 1 to 11: how near, steps in range, places, heights."""
    for j in range(_LANES):
        k = j + _REACH
        r = seen[_R + k]
        one = 1.0 if r > 0 else 0.0
        left, right, up, down = seen[_R + k - 1], seen[_R + k + 1], seen[_R - _WIDE + k], seen[_R + _WIDE + k]
        out[_LANES + j] = one * (4.0 / (r + 2.0))
        out[2 * _LANES + j] = _soft(left - r) * (one if left > 0 else 0.0)
        out[3 * _LANES + j] = _soft(right - r) * (one if right > 0 else 0.0)
        out[4 * _LANES + j] = _soft(up - r) * (one if up > 0 else 0.0)
        out[5 * _LANES + j] = _soft(down - r) * (one if down > 0 else 0.0)
        out[6 * _LANES + j] = one
        out[7 * _LANES + j] = one * (seen[_X + k] / 25.0)
        out[8 * _LANES + j] = one * (seen[_Y + k] / 25.0)
        out[9 * _LANES + j] = one * (seen[_Z + k] / 3.0)
        out[10 * _LANES + j] = one * (min(max(height[j], -2.0), 6.0) / 2.0)
        out[11 * _LANES + j] = one * _soft(height[j])


@njit(cache=True, error_model="numpy")
def _normals(seen: F32, out: F32) -> None:
    """Compute features 12 to 15: the normal along, across and upward, and whether there is one.

    A side of the surface is a difference of the pixels to both sides, or to the centre where one is of another surface.
    """
    for j in range(_LANES):
        k = j + _REACH
        r, x, y, z = seen[_R + k], seen[_X + k], seen[_Y + k], seen[_Z + k]
        near = 0.05 * r + 0.3
        west, east, south, north = k - _REACH, k + _REACH, k + _WIDE, k - _WIDE
        w = (seen[_R + west] > 0) & (abs(seen[_R + west] - r) < near)
        e = (seen[_R + east] > 0) & (abs(seen[_R + east] - r) < near)
        s = (seen[_R + south] > 0) & (abs(seen[_R + south] - r) < near)
        n = (seen[_R + north] > 0) & (abs(seen[_R + north] - r) < near)
        wx, wy, wz = seen[_X + west], seen[_Y + west], seen[_Z + west]
        ex, ey, ez = seen[_X + east], seen[_Y + east], seen[_Z + east]
        sx, sy, sz = seen[_X + south], seen[_Y + south], seen[_Z + south]
        nx, ny, nz = seen[_X + north], seen[_Y + north], seen[_Z + north]
        ax = np.float64((ex if e else x) - (wx if w else x))
        ay = np.float64((ey if e else y) - (wy if w else y))
        az = np.float64((ez if e else z) - (wz if w else z))
        bx = np.float64((nx if n else x) - (sx if s else x))
        by = np.float64((ny if n else y) - (sy if s else y))
        bz = np.float64((nz if n else z) - (sz if s else z))
        u, v, t = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
        norm = np.sqrt(u * u + v * v + t * t)
        known = (r > 0) & (w | e) & (s | n) & (norm > 1e-9)
        norm = norm if known else 1.0
        norm = -norm if u * x + v * y + t * z > 0 else norm  # towards the sensor
        rho = np.sqrt(x * x + y * y) + 1e-6
        one = 1.0 if known else 0.0
        along = np.float32(one * ((u * x + v * y) / (norm * rho)))
        upward = np.float32(one * (t / norm))
        out[12 * _LANES + j] = along
        out[13 * _LANES + j] = one * ((v * x - u * y) / (norm * rho))
        out[14 * _LANES + j] = upward
        out[15 * _LANES + j] = 1.0 if (along != 0) | (upward != 0) else 0.0


@njit(cache=True, inline="always", error_model="numpy")
def _alike(seen: F32, at: int, r: float) -> tuple[float, float]:
    """Sum up the intensities of three pixels but for those of another surface; and how many they are."""
    total = count = 0.0
    for k in range(at + _REACH - 1, at + _REACH + 2):
        one = 1.0 if (seen[_R + k] > 0) & (abs(seen[_R + k] - r) < 0.5) else 0.0
        total += one * seen[_I + k]
        count += one
    return total, count


@njit(cache=True, error_model="numpy")
def _shine(seen: F32, above: int, below: int, out: F32) -> None:
    """Compute features 16 to 18: the intensity, its root, the mean of those around on one surface.

    ``above`` and ``below`` are 0 where there is no such row, else 1.
    """
    for j in range(_LANES):
        r, intensity = seen[_R + j + _REACH], seen[_I + j + _REACH]
        one = 1.0 if r > 0 else 0.0
        over, n = _alike(seen, j - _WIDE, r)
        beside, m = _alike(seen, j, r)
        under, l = _alike(seen, j + _WIDE, r)
        total, count = above * over + beside + below * under, above * n + m + below * l
        out[16 * _LANES + j] = one * (2.0 * intensity)
        out[17 * _LANES + j] = one * np.sqrt(intensity)
        out[18 * _LANES + j] = one * (2.0 * total / max(count, 1.0))
