"""Points without a lattice, of any spinning sensor: each on a ray guessed from the points around it.

Two distances in the list say which points those are: ``left`` points back the same laser fired before, ``up`` points
back is its neighbour in elevation, and both together the neighbour's last one. A cloud that lists firings
(32 lasers each) has (32, 1), an organised one of 1024 columns (1, 1024), one that lists rings (1, 0). Where points are missing
from firings no distance holds: with left 0 every point's laser, its *lane*, is coded, too, and the neighbour is the point before.

The ray is the left point turned by as much as the neighbour turned; the distance along it is guessed in 1/r from the
left, upper and upper left points. What is coded is the difference from the guess, in one of three forms:

* ``ALONG``: steps along the ray and across it; the point moves to where they lead (an error is asked for);
* ``GRID``: whole numbers of a decimal unit per coordinate; ``BITS``, ``HALVES``: ordered float32 or float16 bits per coordinate. The coordinate
  in which the ray points comes first; the other two are guessed again from it.

The decoder repeats all of this, hence only ``+ - * /`` and square roots on float64, in a fixed order.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.entropy.range_coder import new_bits
from salpcc.stages.entropy.residual_bits import CLASSES, PER_CONTEXT, code_number, size_of
from salpcc.stages.entropy.walks import code_mixed_bit, code_mixed_tree, code_raw
from salpcc.stages.lists.rays.ray_forms import (
    ALONG,
    BITS,
    FAR,
    GRID,
    HALVES,
    SPREADS,
    bucket_of,
    coordinate_of,
    ray_of,
    whole_of,
)

NORMAL, ZERO, NAN, LOOSE = 0, 1, 2, 3
WRITE, READ, MOVE = 0, 1, 2
PREDICTORS = 4
_NO_ERROR = 0.5
_PER_ERROR = 1.0 / 65535.0
NAN_BITS = 0x7FC00000

F32 = NDArray[np.float32]
Kinds = NDArray[np.uint8]
Layout = tuple[int, int]  # left, up
Models = tuple[
    NDArray[np.uint16],
    NDArray[np.uint16],
    NDArray[np.uint16],
    NDArray[np.uint16],
    NDArray[np.uint16],
    NDArray[np.uint16],
]


def new_models() -> Models:
    """Return fresh contexts: of kinds, of the number along the ray (two), of those across it (two), of lanes."""
    pairs = CLASSES * CLASSES * PER_CONTEXT
    return (
        new_bits(64 * 4),
        new_bits(SPREADS * PER_CONTEXT),
        new_bits(pairs),
        new_bits(2 * pairs),
        new_bits(2 * 16 * 8 * PER_CONTEXT),
        new_bits(256 * 256),
    )


@njit(cache=True, error_model="numpy")
def code_points(  # type: ignore[no-untyped-def]
    way, points, kinds, lanes, left, up, form, per, step, tolerance, models, state, data
):
    """Write, read or move points ``(S, 3)`` float32 with their kinds ``(S,)``.

    MOVE puts every point where it would decode to, if that is within ``tolerance`` metres (0: the same bits); the
    others stay and become LOOSE.
    """
    n = len(points)
    writing = way == WRITE
    of_kind, of_spread, of_sizes, of_across, of_place, of_lane = models
    inverse = np.zeros(n, np.float32)
    errors = np.zeros((n, PREDICTORS), np.uint16)
    sizes = np.zeros((n, 3), np.uint8)
    last = np.full(left or 256, -1)  # of each laser, as far as the list goes round regularly
    before_last = np.full(left or 256, -1)
    guess = np.zeros(PREDICTORS)
    numbers = np.zeros(3, np.int64)
    recent, recent_lane = -1, 0
    for i in range(n):
        k1 = np.int64(kinds[i - 1]) if i >= 1 else 0
        k2 = np.int64(kinds[i - left]) if left > 0 and i >= left else 0
        k3 = np.int64(kinds[i - up]) if up > 0 and i >= up else 0
        kind = np.int64(kinds[i])
        if way != MOVE:
            context = (k1 * 16 + k2 * 4 + k3) * 4
            high = code_mixed_bit(writing, state, data, of_kind, context, of_kind, context + 1, kind >> 1)
            low = code_mixed_bit(
                writing, state, data, of_kind, context + 2 + high, of_kind, context + 2 + high, kind & 1
            )
            kind = high * 2 + low
            kinds[i] = kind
        if kind in (ZERO, NAN):
            if way == READ:
                bits = np.int32(0 if kind == ZERO else NAN_BITS)
                points[i, 0] = points[i, 1] = points[i, 2] = bits.view(np.float32)
            continue
        if kind == LOOSE:
            for c in range(3):
                whole = whole_of(points[i, c], BITS, per) + (1 << 31)
                high = code_raw(writing, state, data, 16, whole >> 16) if way != MOVE else 0
                low = code_raw(writing, state, data, 16, whole & 0xFFFF) if way != MOVE else 0
                if way == READ:
                    points[i, c] = coordinate_of((high << 16 | low) - (1 << 31), BITS, per)
            continue
        if state[3] != 0:
            return
        source_x, source_y, source_z = (
            np.float64(points[i, 0]),
            np.float64(points[i, 1]),
            np.float64(points[i, 2]),
        )
        if left > 0:
            lane = i % left
        else:
            lane = np.int64(lanes[i])
            if way != MOVE:
                row = recent_lane * 256
                lane = np.int64(code_mixed_tree(writing, state, data, of_lane, row, of_lane, row, 8, lane))
                lanes[i] = lane
        place, before = last[lane], before_last[lane]
        if place < 0:
            place, before = recent, -1
        upper = i - up if up > 0 and i >= up and inverse[i - up] > 0.0 else -1
        upper_left = (
            place - up if left > 0 and upper >= 0 and place >= up and inverse[place - up] > 0.0 else -1
        )
        if left == 0 and recent >= 0 and recent_lane != lane:
            upper, upper_left = recent, before_last[recent_lane]
        if place < 0:
            dx, dy, dz = 1.0, 0.0, 0.0
            guess[:] = 0.1
        else:
            dx, dy, dz = ray_of(points, place, before, upper, upper_left)
            near = np.float64(inverse[place])
            guess[:] = near
            if upper >= 0:
                guess[1] = inverse[upper]
            if upper_left >= 0:
                guess[2] = near + np.float64(inverse[upper]) - np.float64(inverse[upper_left])
            if before >= 0:
                guess[3] = 2.0 * near - np.float64(inverse[before])
        total = 0.0
        mean = 0.0
        spread = 0.0
        for p in range(PREDICTORS):
            guess[p] = min(max(guess[p], 1.0 / 1000.0), 10.0)
            error = 1e-4
            error += errors[place, p] * _PER_ERROR if place >= 0 else _NO_ERROR
            error += errors[upper, p] * _PER_ERROR if upper >= 0 else error
            weight = 1.0 / (error * error)
            weight = weight * weight
            total += weight
            mean += weight * guess[p]
            spread += weight * error
        r = total / mean
        spread = spread / total * r * 0.5

        size1 = np.int64(sizes[place, 0]) if place >= 0 else CLASSES - 1
        size2 = (
            np.int64(sizes[upper, 0])
            if upper >= 0
            else (np.int64(sizes[recent, 0]) if recent >= 0 else CLASSES - 1)
        )
        if form == ALONG:
            ground = np.sqrt(dx * dx + dy * dy)
            sx, sy = (-dy / ground, dx / ground) if ground > 1e-9 else (0.0, 1.0)
            # The third axis: the ray's direction times the one across it.
            tx, ty, tz = -dz * sy, dz * sx, dx * sy - dy * sx
            if way != READ:
                ox, oy, oz = source_x - r * dx, source_y - r * dy, source_z - r * dz
                numbers[0] = np.int64(np.rint((ox * dx + oy * dy + oz * dz) / step))
                numbers[1] = np.int64(np.rint((ox * sx + oy * sy) / step))
                numbers[2] = np.int64(np.rint((ox * tx + oy * ty + oz * tz) / step))
            unit = step
        else:
            axis = 0
            if abs(dy) > abs(dx):
                axis = 1
            if abs(dz) > max(abs(dx), abs(dy)):
                axis = 2
            along = dx if axis == 0 else (dy if axis == 1 else dz)
            whole = whole_of(r * along, form, per)
            if way != READ:
                numbers[0] = whole_of(points[i, axis], form, per) - whole
            unit = 1.0 / per if form == GRID else r * (1e-3 if form == HALVES else 1.2e-7)
        if way != MOVE:
            numbers[0] = code_number(
                writing, state, data, of_spread, bucket_of(spread, unit),
                of_sizes, size1 * CLASSES + size2, numbers[0],
            )  # fmt: skip
        sizes[i, 0] = (size_of(abs(numbers[0])) + 1) // 2
        if form != ALONG:
            points[i, axis] = coordinate_of(whole + numbers[0], form, per)
            r = min(max(np.float64(points[i, axis]) / along, 1e-3), FAR)
        reach = min(bucket_of(r, 0.25) // 2, 15)
        for c in range(1, 3):
            other = axis + c if form != ALONG else 0
            other = other - 3 if other >= 3 else other
            if form != ALONG:
                whole = whole_of(r * (dx if other == 0 else (dy if other == 1 else dz)), form, per)
                if way != READ:
                    numbers[c] = whole_of(points[i, other], form, per) - whole
            if way != MOVE:
                side = np.int64(sizes[place, c]) if place >= 0 else CLASSES - 1
                close = np.int64(sizes[recent, c]) if recent >= 0 else CLASSES - 1
                numbers[c] = code_number(
                    writing, state, data, of_across, ((c - 1) * CLASSES + side) * CLASSES + close,
                    of_place, ((c - 1) * 16 + reach) * 8 + min(np.int64(sizes[i, 0]), 7), numbers[c],
                )  # fmt: skip
            sizes[i, c] = (size_of(abs(numbers[c])) + 1) // 2
            if form != ALONG:
                points[i, other] = coordinate_of(whole + numbers[c], form, per)
        if form == ALONG:
            a, b, c = r + numbers[0] * step, numbers[1] * step, numbers[2] * step
            points[i, 0] = a * dx + b * sx + c * tx
            points[i, 1] = a * dy + b * sy + c * ty
            points[i, 2] = a * dz + c * tz
        if way == MOVE:
            ox, oy, oz = points[i, 0] - source_x, points[i, 1] - source_y, points[i, 2] - source_z
            fits = np.sqrt(ox * ox + oy * oy + oz * oz) <= tolerance
            if tolerance == 0.0:
                fits = (
                    whole_of(points[i, 0], BITS, per) == whole_of(source_x, BITS, per)
                    and whole_of(points[i, 1], BITS, per) == whole_of(source_y, BITS, per)
                    and whole_of(points[i, 2], BITS, per) == whole_of(source_z, BITS, per)
                )
            if not fits:
                points[i, 0], points[i, 1], points[i, 2] = source_x, source_y, source_z
                kinds[i] = LOOSE
                sizes[i] = 0
                continue
        x, y, z = np.float64(points[i, 0]), np.float64(points[i, 1]), np.float64(points[i, 2])
        r = np.sqrt(x * x + y * y + z * z)
        if not (1e-3 < r < FAR):
            continue
        inverse[i] = 1.0 / r
        for p in range(PREDICTORS):
            errors[i, p] = np.uint16(min(abs(guess[p] * r - 1.0), 1.0) * 65535.0)
        before_last[lane], last[lane] = last[lane], i
        recent, recent_lane = i, lane
