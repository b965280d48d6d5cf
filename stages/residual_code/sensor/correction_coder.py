"""Corrections of a rounding, found by how close each coordinate came to the rounding boundary.

Only coordinates nearer to the boundary than the farthest corrected one (the *reach*, sent beside the
stream) can be corrected; for those a bit in the context of the distance tells. A correction almost
always steps across the boundary.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.entropy.walks import code_bit, finish_coder, start_coder, uncounted
from salpcc.stages.lattice.lattice import NO_CORRECTION, digits_of
from salpcc.stages.lattice.publish import (
    Column,
    Rounded,
    compensate,
    float32_boundary,
    millimetre_boundary,
)
from salpcc.stages.lattice.untwist import BLOCK

MILLIMETRE, FLOAT32 = 0, 1
_BUCKETS = 24
CONTEXTS = _BUCKETS + 1
_ACROSS = _BUCKETS


class Near(NamedTuple):
    """A block of points in short columns: coordinates before a rounding, their distances to its boundary, steps across it."""

    x: Column
    y: Column
    z: Column
    dx: Column
    dy: Column
    dz: Column
    sx: Column
    sy: Column
    sz: Column


@njit(cache=True)
def _room(size: int) -> Near:
    """Return room for a block of ``size`` points."""
    columns = np.empty((9, size))
    return Near(
        columns[0],
        columns[1],
        columns[2],
        columns[3],
        columns[4],
        columns[5],
        columns[6],
        columns[7],
        columns[8],
    )


@njit(cache=True)
def _bucket(distance: float, reach: float) -> int:
    """Half-octave bucket of the distance below the reach."""
    bucket = 0
    limit = reach * 0.7071067811865476
    while bucket < _BUCKETS - 1 and distance < limit:
        limit *= 0.7071067811865476
        bucket += 1
    return bucket


@njit(cache=True, _nrt=False, inline="always")
def _boundary(rounding: int, value: float) -> tuple[float, float]:
    """Distance of a coordinate to the boundary of a rounding, and the step across it."""
    return millimetre_boundary(value) if rounding == MILLIMETRE else float32_boundary(value)


@uncounted
def _coordinates(rounding: int, given: Rounded, start: int, size: int, near: Near) -> None:
    """Fill the coordinates of ``size`` points from ``start`` on, as they are before the rounding."""
    if rounding == FLOAT32:
        compensate(given, start, size, near.x, near.y, near.z)
        return
    for i in range(size):
        near.x[i], near.y[i], near.z[i] = (
            given.model[start + i, 0],
            given.model[start + i, 1],
            given.model[start + i, 2],
        )


@uncounted
def _boundaries(rounding: int, coordinate: Column, size: int, distance: Column, step: Column) -> None:
    """Fill distances and steps of coordinates; all ``(size,)``."""
    for i in range(size):
        distance[i], step[i] = _boundary(rounding, coordinate[i])


@njit(cache=True)
def correction_reach(rounding: int, given: Rounded, codes: NDArray[np.uint8]) -> float:
    """Return the largest distance at which a coordinate of points ``(M, 3)`` is corrected, -1 if none is."""
    reach = -1.0
    near = _room(1)
    for i in range(len(codes)):
        if codes[i] != NO_CORRECTION:
            _coordinates(rounding, given, i, 1, near)
            point, digits = (near.x[0], near.y[0], near.z[0]), digits_of(np.int64(codes[i]))
            for c in range(3):
                if digits[c] != 0:
                    reach = max(reach, _boundary(rounding, point[c])[0])
    return reach


@uncounted
def _walk(
    writing: bool,
    state: NDArray[np.int64],
    rounding: int,
    given: Rounded,
    reach: float,
    codes: NDArray[np.uint8],
    model: NDArray[np.uint16],
    near: Near,
    buffer: NDArray[np.uint8],
) -> int:
    """Code corrections ``(M,)``; what no coordinate is near enough for stays as it is: none."""
    for start in range(0, len(codes), BLOCK):
        size = min(BLOCK, len(codes) - start)
        _coordinates(rounding, given, start, size, near)
        _boundaries(rounding, near.x, size, near.dx, near.sx)
        _boundaries(rounding, near.y, size, near.dy, near.sy)
        _boundaries(rounding, near.z, size, near.dz, near.sz)
        for i in range(size):
            distance = near.dx[i], near.dy[i], near.dz[i]
            if min(distance[0], distance[1], distance[2]) > reach:
                continue
            steps = near.sx[i], near.sy[i], near.sz[i]
            digits = digits_of(np.int64(codes[start + i]))
            code = np.int64(0)
            for c in range(3):
                digit, across = np.int64(0), np.int64(steps[c])
                if distance[c] <= reach:
                    context = _bucket(distance[c], reach)
                    if code_bit(writing, state, buffer, model, context, 1 if digits[c] != 0 else 0):
                        back = code_bit(
                            writing, state, buffer, model, _ACROSS, 1 if digits[c] != across else 0
                        )
                        digit = -across if back else across
                code = code * 3 + digit + 1
            codes[start + i] = code
    return finish_coder(writing, state, buffer)


@njit(cache=True)
def encode_corrections(
    rounding: int,
    given: Rounded,
    reach: float,
    codes: NDArray[np.uint8],
    model: NDArray[np.uint16],
    out: NDArray[np.uint8],
) -> int:
    """Encode correction codes 0..26 ``(M,)``; return the bytes written to ``out``, -1 if full.

    Args:
        rounding: MILLIMETRE or FLOAT32, of points ``(M, 3)``; see :mod:`salpcc.stages.lattice.publish`. The former needs the
            corrections in ``given`` for nothing.
    """
    return _walk(True, start_coder(True, out), rounding, given, reach, codes.copy(), model, _room(BLOCK), out)


@njit(cache=True, nogil=True)
def decode_corrections(
    rounding: int,
    given: Rounded,
    reach: float,
    model: NDArray[np.uint16],
    data: NDArray[np.uint8],
) -> tuple[NDArray[np.uint8], bool]:
    """Inverse of :func:`encode_corrections`; the codes and whether the data sufficed."""
    codes, coder = np.full(len(given.model), NO_CORRECTION, np.uint8), start_coder(False, data)
    return codes, _walk(False, coder, rounding, given, reach, codes, model, _room(BLOCK), data) == 0
