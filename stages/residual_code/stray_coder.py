"""Strays, the points without a lattice: their places, and x, y, z as :mod:`.ray_coder` has them.

Stream: length of the places (uint32), the places as gaps, form, left, up and per (uint8, uint16, uint16, uint32), the points.
"""

from __future__ import annotations

import struct

import numpy as np
from numpy.typing import NDArray

from salpcc.stages.ingest.publish import from_ordered_bits, ordered_bits
from salpcc.stages.residual_code.integer_coder import decode_integers, encode_integers, integer_model
from salpcc.stages.residual_code.layout import find_layout
from salpcc.stages.residual_code.ray_coder import Layout
from salpcc.stages.residual_code.ray_forms import ALONG, BITS, GRID
from salpcc.stages.residual_code.ray_stream import move_points, read_points, write_points

_HEAD = struct.Struct("<IBHHI")
_UNITS = (1000, 100, 10000, 1)  # grid lines in a metre
_ON_GRID = 0.9  # of the points
_HOPELESS = 8  # bytes a point


def ray_step(max_error: float) -> float:
    """Edge of cubes whose centres are within ``max_error`` metres; 0 where it is exact.

    10 micrometres are set aside for the rounding of the centre to float32.
    """
    return max(2.0 * (max_error - 1e-5) / 1.7320508075688772, 0.0) if max_error > 0 else 0.0


def _form(points: NDArray[np.float32], max_error: float) -> tuple[int, int, float]:
    """Form, grid lines in a metre, and step that points ``(S, 3)`` are coded with."""
    step = ray_step(max_error)
    if step > 0.0:
        return ALONG, 1, step
    sample = points[np.isfinite(points).all(axis=1)][:: len(points) // 4000 + 1].astype(np.float64)
    for per in _UNITS:
        same = (np.rint(sample * per) / per).astype(np.float32) == sample
        if len(sample) and same.all(axis=1).mean() > _ON_GRID:
            return GRID, per, 0.0
    return BITS, 1, 0.0


def snap(points: NDArray[np.float32], max_error: float) -> NDArray[np.float32]:
    """Move points ``(S, 3)`` to where the coder will put them, where that keeps the bound."""
    if ray_step(max_error) == 0.0 or len(points) == 0:
        return points
    form, per, step = _form(points, max_error)
    layout = find_layout(points, form, per, step, max_error)
    return move_points(np.ascontiguousarray(points), layout, form, per, step, max_error)[0]


def layout_of(points: NDArray[np.float32], max_error: float) -> Layout:
    """Return the layout in which points ``(S, 3)``, snapped if need be, are coded."""
    return find_layout(points, *_form(points, max_error), 0.0)


def encode_strays(
    places: NDArray[np.int64],
    points: NDArray[np.float32],
    max_error: float,
    layout: Layout,
    out: NDArray[np.uint8],
) -> int:
    """Encode places ``(S,)`` and points ``(S, 3)``; return the bytes written to ``out``, -1 if full."""
    if len(places) == 0:
        return 0
    points = np.ascontiguousarray(points)
    form, per, step = _form(points, max_error)
    gaps = np.diff(places, prepend=-1) - 1
    first = int(encode_integers(gaps[:, None], integer_model(1), out[_HEAD.size :]))
    if first < 0:
        return -1
    out[: _HEAD.size] = np.frombuffer(_HEAD.pack(first, form, *layout, per), np.uint8)
    begin = _HEAD.size + first
    written = write_points(points, layout, form, per, step, out[begin:])
    if form == ALONG and written > _HOPELESS * len(points):  # points that were moved by another layout
        out[: _HEAD.size] = np.frombuffer(_HEAD.pack(first, BITS, *layout, per), np.uint8)
        written = write_points(points, layout, BITS, per, 0.0, out[begin:])
    return written + begin if written >= 0 else -1


def decode_strays(
    n: int, max_error: float, data: NDArray[np.uint8]
) -> tuple[NDArray[np.int64], NDArray[np.float32], bool]:
    """Inverse of :func:`encode_strays`: places, points, and whether the data made sense."""
    nothing = np.zeros(n, np.int64), np.zeros((n, 3), np.float32), n == 0
    if n == 0 or len(data) < _HEAD.size:
        return nothing
    first, form, left, up, per = _HEAD.unpack(data[: _HEAD.size].tobytes())
    begin = _HEAD.size + first
    step = ray_step(max_error)
    if begin > len(data) or form > BITS or per == 0 or (form == ALONG and step == 0.0):
        return nothing
    rows, sound = decode_integers(n, 1, integer_model(1), np.ascontiguousarray(data[_HEAD.size : begin]))
    places = np.cumsum(rows[:, 0] + 1) - 1
    points, whole = read_points(n, (left, up), form, per, step, np.ascontiguousarray(data[begin:]))
    return places, points, bool(sound and whole)


def encode_floats(values: NDArray[np.float32], out: NDArray[np.uint8]) -> int:
    """Encode float32 values ``(S,)`` exactly; return the bytes written to ``out``, -1 if full."""
    return int(encode_integers(ordered_bits(np.ascontiguousarray(values))[:, None], integer_model(1), out))


def decode_floats(n: int, data: NDArray[np.uint8]) -> tuple[NDArray[np.float32], bool]:
    """Inverse of :func:`encode_floats`."""
    rows, sound = decode_integers(n, 1, integer_model(1), data)
    return from_ordered_bits(np.clip(rows[:, 0], -(1 << 31), (1 << 31) - 1)), bool(sound)
