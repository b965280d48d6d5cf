"""What the network reads at each pixel: the tensors M_dep, M_coor and M_int of section IV, with geometry.

Beside range, coordinates and intensity there are range steps to the four neighbours, the height above
the ground and the surface normal: fifty labelled scans are too few to learn these from raw numbers.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

F32 = NDArray[np.float32]

DEPTH, COORDINATES, INTENSITY = 7, 9, 3
CHANNELS = DEPTH + COORDINATES + INTENSITY
_REACH = 3  # columns to either side that a normal is measured over; one is less than the range noise
_SOFT = 0.2  # metres; a step of this size is half of a large one


@njit(cache=True)
def _difference(
    planes: F32, row: int, left: int, up: int, down: int, right: int, centre: int, out: NDArray[np.float64]
) -> bool:
    """Vector between two pixels (up, left) and (down, right), or from the centre where one is of another surface."""
    r = planes[3, row, centre]
    near = 0.05 * r + 0.3
    first = planes[3, up, left]
    second = planes[3, down, right]
    first_good = first > 0 and abs(first - r) < near
    second_good = second > 0 and abs(second - r) < near
    if not (first_good or second_good):
        return False
    for k in range(3):
        a = planes[k, up, left] if first_good else planes[k, row, centre]
        b = planes[k, down, right] if second_good else planes[k, row, centre]
        out[k] = b - a
    return True


@njit(cache=True)
def _soft(step: float) -> float:
    return step / (_SOFT + abs(step))


@njit(cache=True)
def _beside(column: int, step: int, columns: int, circular: bool) -> tuple[int, int]:
    left, right = column - step, column + step
    if left < 0:
        left = left + columns if circular else 0
    if right >= columns:
        right = right - columns if circular else columns - 1
    return left, right


def pixel_features(planes: F32, circular: bool) -> F32:
    """Return features ``(19, H, W)`` float32 of range-image planes ``(6, H, W)``; 0 where there is no return.

    Those of a pixel lie together in memory.

    Args:
        circular: whether the last column is the first one's neighbour (whole turns, not crops).
    """
    return _features(planes, circular).transpose(2, 0, 1)


@njit(cache=True)
def _features(planes: F32, circular: bool) -> F32:
    _, rows, columns = planes.shape
    out = np.zeros((rows, columns, CHANNELS), np.float32)
    across = np.zeros(3)
    upward = np.zeros(3)
    for i in range(rows):
        above = max(i - 1, 0)
        below = min(i + 1, rows - 1)
        for j in range(columns):
            r = planes[3, i, j]
            if r <= 0:
                continue
            one_left, one_right = _beside(j, 1, columns, circular)
            left, right = _beside(j, _REACH, columns, circular)
            out[i, j, 0] = np.log(r) / 3.0
            out[i, j, 1] = 4.0 / (r + 2.0)
            beside = (
                planes[3, i, one_left],
                planes[3, i, one_right],
                planes[3, above, j],
                planes[3, below, j],
            )
            for k in range(4):
                out[i, j, 2 + k] = _soft(beside[k] - r) if beside[k] > 0 else 0.0
            out[i, j, 6] = 1.0

            x, y, z = planes[0, i, j], planes[1, i, j], planes[2, i, j]
            out[i, j, 7] = x / 25.0
            out[i, j, 8] = y / 25.0
            out[i, j, 9] = z / 3.0
            height = planes[5, i, j]
            out[i, j, 10] = min(max(height, -2.0), 6.0) / 2.0
            out[i, j, 11] = _soft(height)
            if _difference(planes, i, left, i, i, right, j, across) and _difference(
                planes, i, j, below, above, j, j, upward
            ):
                nx = across[1] * upward[2] - across[2] * upward[1]
                ny = across[2] * upward[0] - across[0] * upward[2]
                nz = across[0] * upward[1] - across[1] * upward[0]
                norm = np.sqrt(nx * nx + ny * ny + nz * nz)
                if norm > 1e-9:
                    if nx * x + ny * y + nz * z > 0:  # towards the sensor
                        norm = -norm
                    rho = np.sqrt(x * x + y * y) + 1e-6
                    out[i, j, 12] = (nx * x + ny * y) / (norm * rho)
                    out[i, j, 13] = (ny * x - nx * y) / (norm * rho)
                    out[i, j, 14] = nz / norm
            out[i, j, 15] = 1.0 if out[i, j, 12] != 0 or out[i, j, 14] != 0 else 0.0

            intensity = planes[4, i, j]
            out[i, j, 16] = 2.0 * intensity
            out[i, j, 17] = np.sqrt(intensity)
            total = 0.0
            seen = 0
            for a in range(above, below + 1):
                for b in (one_left, j, one_right):
                    if planes[3, a, b] > 0 and abs(planes[3, a, b] - r) < 0.5:
                        total += planes[4, a, b]
                        seen += 1
            out[i, j, 18] = 2.0 * total / seen
    return out
