"""Strays, the points without a lattice: their places, and x, y, z as float32 bits or grid indices.

A stray of a sweep with a guaranteed error lies on a grid (:func:`snap`); one that cannot (NaN, far
away) keeps its bits. Both are columns of integers for :mod:`.integer_coder`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from salpcc.stages.ingest.publish import from_ordered_bits, ordered_bits
from salpcc.stages.residual_code.integer_coder import decode_integers, encode_integers, integer_model

_COLUMNS = 5  # gap in places, raw or grid, x, y, z
_MAX_INDEX = float(1 << 40)


def grid_step(max_error: float) -> float:
    """Edge of the grid cells whose centres are within ``max_error`` metres; 0 where it is exact.

    10 micrometres are set aside for the rounding of the centre to float32.
    """
    return max(2.0 * (max_error - 1e-5) / 1.7320508075688772, 0.0) if max_error > 0 else 0.0


def snap(points: NDArray[np.float32], max_error: float) -> NDArray[np.float32]:
    """Move points ``(S, 3)`` to the centres of their grid cells, where that keeps the bound."""
    step = grid_step(max_error)
    if step == 0.0 or len(points) == 0:
        return points
    with np.errstate(invalid="ignore", over="ignore"):
        centres = (np.rint(points.astype(np.float64) / step) * step + 0.0).astype(np.float32)  # no -0.0
        off = np.sqrt(((centres.astype(np.float64) - points) ** 2).sum(axis=1))
        usable = (off <= max_error) & (np.abs(points) < _MAX_INDEX * step).all(axis=1)
    return np.where(np.asarray(usable)[:, None], centres, points)


def _integers(values: NDArray[np.float32], step: float) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Columns x, y, z as grid indices where the row lies on the grid, else as ordered bits."""
    bits = ordered_bits(np.ascontiguousarray(values))
    if step == 0.0:
        return bits, np.ones(len(values), np.bool_)
    with np.errstate(invalid="ignore"):
        near = np.asarray((np.abs(values) < _MAX_INDEX * step).all(axis=1))  # NaN is not
        index = np.rint(np.where(near[:, None], values, 0.0).astype(np.float64) / step).astype(np.int64)
        on_grid = near & ((index * step).astype(np.float32).view(np.int32) == values.view(np.int32)).all(
            axis=1
        )
    return np.where(on_grid[:, None], index, bits), ~on_grid


def encode_strays(
    places: NDArray[np.int64], points: NDArray[np.float32], max_error: float, out: NDArray[np.uint8]
) -> int:
    """Encode places ``(S,)`` and points ``(S, 3)``; return the bytes written to ``out``, -1 if full."""
    columns, raw = _integers(np.ascontiguousarray(points), grid_step(max_error))
    rows = np.column_stack([np.cumsum(np.diff(places, prepend=-1) - 1), raw.astype(np.int64), columns])
    return int(encode_integers(rows.astype(np.int64), integer_model(_COLUMNS), out))


def decode_strays(
    n: int, max_error: float, data: NDArray[np.uint8]
) -> tuple[NDArray[np.int64], NDArray[np.float32], bool]:
    """Inverse of :func:`encode_strays`: places, points, and whether the data made sense."""
    rows, sound = decode_integers(n, _COLUMNS, integer_model(_COLUMNS), data)
    places = rows[:, 0] + np.arange(n)
    bits = np.clip(rows[:, 2:], -(1 << 31), (1 << 31) - 1)
    centres = (rows[:, 2:] * grid_step(max_error)).astype(np.float32)
    points = np.where((rows[:, 1] != 0)[:, None], from_ordered_bits(bits), centres)
    return places, points, bool(sound)


def encode_floats(values: NDArray[np.float32], out: NDArray[np.uint8]) -> int:
    """Encode float32 values ``(S,)`` exactly; return the bytes written to ``out``, -1 if full."""
    return int(encode_integers(ordered_bits(np.ascontiguousarray(values))[:, None], integer_model(1), out))


def decode_floats(n: int, data: NDArray[np.uint8]) -> tuple[NDArray[np.float32], bool]:
    """Inverse of :func:`encode_floats`."""
    rows, sound = decode_integers(n, 1, integer_model(1), data)
    return from_ordered_bits(np.clip(rows[:, 0], -(1 << 31), (1 << 31) - 1)), bool(sound)
