"""Points as the bytes of :mod:`.ray_coder`, and where they have to lie for it."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.entropy.range_coder import finish_encoder, start_decoder, start_encoder
from salpcc.stages.lists.rays.lanes import find_lanes
from salpcc.stages.lists.rays.ray_coder import (
    F32,
    LOOSE,
    MOVE,
    NAN,
    NAN_BITS,
    NORMAL,
    READ,
    WRITE,
    ZERO,
    Kinds,
    Layout,
    code_points,
    new_models,
)
from salpcc.stages.lists.rays.ray_forms import ALONG, BITS, FAR, coordinate_of, whole_of


@njit(cache=True, error_model="numpy")
def _loosen(points: F32, kinds: Kinds, form: int, per: float) -> None:
    """Make LOOSE what the numbers of a form that codes coordinates do not hold; where a point was guessed does not matter to that."""
    for i in range(len(points)):
        if kinds[i] != NORMAL:
            continue
        for c in range(3):
            value = np.float64(points[i, c])
            held = np.float64(coordinate_of(whole_of(value, form, per), form, per))
            if whole_of(held, BITS, per) != whole_of(value, BITS, per):
                kinds[i] = LOOSE


def move_points(
    points: F32,
    layout: Layout,
    form: int,
    per: float,
    step: float,
    tolerance: float,
    lanes: Kinds | None = None,
) -> tuple[F32, Kinds, Kinds]:
    """Return where points ``(S, 3)`` decode to, at most ``tolerance`` metres away, their kinds and lanes ``(S,)``, guessed if not given."""
    bits = np.ascontiguousarray(points).view(np.int32)
    with np.errstate(invalid="ignore"):
        kinds = np.where((np.abs(points) < FAR).all(axis=1), NORMAL, LOOSE).astype(np.uint8)
    kinds[(bits == 0).all(axis=1)] = ZERO
    kinds[(bits == NAN_BITS).all(axis=1)] = NAN
    moved = points.copy()
    if layout[0] > 0:
        lanes = np.zeros(1, np.uint8)
    elif lanes is None:
        lanes = find_lanes(points)
    if form != ALONG and tolerance == 0.0:
        _loosen(moved, kinds, form, float(per))
        return moved, kinds, lanes
    unread = np.zeros(1, np.uint8)
    code_points(
        MOVE, moved, kinds, lanes, *layout, form, float(per), float(step), float(tolerance),
        new_models(), start_decoder(unread), unread,
    )  # fmt: skip
    return moved, kinds, lanes


def write_points(
    points: F32,
    layout: Layout,
    form: int,
    per: float,
    step: float,
    out: NDArray[np.uint8],
    lanes: Kinds | None = None,
) -> int:
    """Write points exactly; return the bytes written to ``out``, -1 if full."""
    moved, kinds, lanes = move_points(points, layout, form, per, step, 0.0, lanes)
    state = start_encoder()
    code_points(
        WRITE, moved, kinds, lanes, *layout, form, float(per), float(step), 0.0, new_models(), state, out
    )
    return int(finish_encoder(state, out))


def read_points(
    n: int, layout: Layout, form: int, per: float, step: float, data: NDArray[np.uint8]
) -> tuple[F32, bool]:
    """Inverse of :func:`write_points`: points ``(n, 3)`` and whether the data sufficed."""
    points, kinds = np.zeros((n, 3), np.float32), np.zeros(n, np.uint8)
    lanes = np.zeros(n, np.uint8)
    state = start_decoder(data)
    code_points(
        READ, points, kinds, lanes, *layout, form, float(per), float(step), 0.0, new_models(), state, data
    )
    return points, bool(state[3] == 0)
