"""Guesses of 1/r in a range image from its neighbours, from the frames before and from ground planes.

1/r is linear in the direction over a plane, so differences of 1/r carry from column to column and from row to row.
An image (a predicted frame, the planes) guesses itself, and itself shifted by how far off it was close by.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.schemas.grid import COLUMNS

GUESSES = 17
BEFORE = 4  # filled columns of the row that are remembered
_PER_IMAGE = 4


@njit(cache=True, error_model="numpy")
def _near(image: NDArray[np.float64], row: int, column: int) -> float:
    """Value at a cell, else of the cells up to two columns away; the mean of both sides where they agree."""
    if row < 0:
        return 0.0
    if image[row, column] > 0.0:
        return image[row, column]
    a = image[row, column - 1] if column > 0 else 0.0
    b = image[row, column + 1] if column + 1 < COLUMNS else 0.0
    if a > 0.0 and b > 0.0:
        return 0.5 * (a + b) if abs(a - b) * 16.0 < a + b else max(a, b)
    if a > 0.0 or b > 0.0:
        return max(a, b)
    a = image[row, column - 2] if column > 1 else 0.0
    if a > 0.0:
        return a
    return image[row, column + 2] if column + 2 < COLUMNS else 0.0


@njit(cache=True, error_model="numpy")
def _from_image(
    guesses: NDArray[np.float64],
    first: int,
    image: NDArray[np.float64],
    known: NDArray[np.float64],
    row: int,
    column: int,
    up_row: int,
    before: NDArray[np.int64],
    n_before: int,
) -> None:
    """Four guesses: the image, and the image as far off as at the left, above, and around on the mean."""
    value = image[row, column]
    if value <= 0.0:
        return
    total, count = 0.0, 0
    for k in range(_PER_IMAGE):
        guesses[first + k] = value
    for m in range(n_before):
        if image[row, before[m]] > 0.0:
            off = known[row, before[m]] - image[row, before[m]]
            total += off
            count += 1
            if m == 0:
                guesses[first + 1] = value + off
    if up_row >= 0:
        for c in range(max(column - 1, 0), min(column + 2, COLUMNS)):
            if known[up_row, c] > 0.0 and image[up_row, c] > 0.0:
                off = known[up_row, c] - image[up_row, c]
                total += off
                count += 1
                if c == column:
                    guesses[first + 2] = value + off
    if count > 0:
        guesses[first + 3] = value + total / count


@njit(cache=True, error_model="numpy")
def guess(
    guesses: NDArray[np.float64],
    known: NDArray[np.float64],
    frame: NDArray[np.float64],
    plane: NDArray[np.float64],
    row: int,
    column: int,
    up_row: int,
    up2_row: int,
    before: NDArray[np.int64],
    n_before: int,
    slope: float,
) -> None:
    """Write the GUESSES of 1/r at a cell.

    Args:
        known, frame, plane: ``(64, 2000)`` 1/r, 0 where there is none: what is coded so far, the predicted
            frame, the planes.
        up_row, up2_row: the last two rows above with returns, -1: none.
        before: the columns of the last ``n_before`` returns of the row, the last one first.
        slope: angle between this row and the one above, over that between those above; 0 where not known.
    """
    left = known[row, before[0]] if n_before > 0 else 0.0
    up = _near(known, up_row, column)
    base = left if left > 0.0 else (up if up > 0.0 else 1e-4)
    if up <= 0.0:
        up = base
    for k in range(GUESSES):
        guesses[k] = base
    if n_before >= 2:
        gap, gap2 = column - before[0], before[0] - before[1]
        if gap <= 3 * gap2:
            guesses[1] = left + (left - known[row, before[1]]) * (gap / gap2)
    if n_before == BEFORE:
        sx, sy, sxx, sxy = 0.0, 0.0, 0.0, 0.0
        for m in range(BEFORE):
            x, y = np.float64(before[m] - column), known[row, before[m]]
            sx += x
            sy += y
            sxx += x * x
            sxy += x * y
        slope_x = (BEFORE * sxy - sx * sy) / (BEFORE * sxx - sx * sx)
        guesses[2] = (sy - slope_x * sx) / BEFORE
        guesses[3] = sy / BEFORE
    guesses[4] = up
    guesses[5] = up
    guesses[6] = up
    total, count = 0.0, 0
    for m in range(min(n_before, 3)):
        above = _near(known, up_row, before[m])
        if above > 0.0:
            total += known[row, before[m]] - above
            count += 1
            if m == 0:
                guesses[5] = left + up - above
                guesses[6] = left * up / above
    guesses[7] = up + total / count if count > 0 else up
    up2 = _near(known, up2_row, column)
    guesses[8] = up + (up - up2) * slope if up2 > 0.0 else up
    for first in (9, 13):
        guesses[first + 1] = guesses[5]
        guesses[first + 2] = up
        guesses[first + 3] = guesses[7]
    _from_image(guesses, 9, frame, known, row, column, up_row, before, n_before)
    _from_image(guesses, 13, plane, known, row, column, up_row, before, n_before)
    for k in range(GUESSES):
        if not guesses[k] > 1e-7:
            guesses[k] = base
