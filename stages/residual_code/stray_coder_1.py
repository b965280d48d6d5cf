"""Strays of codec version 1, which is read and no longer written: columns of plain integers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from salpcc.stages.ingest.publish import from_ordered_bits
from salpcc.stages.residual_code.integer_coder import decode_integers, integer_model
from salpcc.stages.residual_code.stray_coder import ray_step

_COLUMNS = 5  # gap in places, raw or grid, x, y, z


def decode_strays_1(
    n: int, max_error: float, data: NDArray[np.uint8]
) -> tuple[NDArray[np.int64], NDArray[np.float32], bool]:
    """Return places ``(S,)``, points ``(S, 3)``, and whether the data made sense."""
    rows, sound = decode_integers(n, _COLUMNS, integer_model(_COLUMNS), data)
    places = rows[:, 0] + np.arange(n)
    bits = np.clip(rows[:, 2:], -(1 << 31), (1 << 31) - 1)
    centres = (rows[:, 2:] * ray_step(max_error)).astype(np.float32)
    points = np.where((rows[:, 1] != 0)[:, None], from_ordered_bits(bits), centres)
    return places, points, bool(sound)
