"""Corrections of a rounding, found by how close each coordinate came to the rounding boundary.

Only coordinates nearer to the boundary than the farthest corrected one (the *reach*, sent beside the
stream) can be corrected; for those a bit in the context of the distance tells. A correction almost
always steps across the boundary.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.entropy.walks import code_bit, finish_coder, start_coder, uncounted
from salpcc.stages.lattice.publish import float32_boundary, millimetre_boundary
from salpcc.stages.lattice.untwist import BLOCK

MILLIMETRE, FLOAT32 = 0, 1
_BUCKETS = 24
CONTEXTS = _BUCKETS + 1
_ACROSS = _BUCKETS
_NONE = 13


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
def _boundary(rounding: int, value: np.float64) -> tuple[np.float64, np.int8]:
    """Distance of a coordinate to the boundary of a rounding, and the step across it."""
    return millimetre_boundary(value) if rounding == MILLIMETRE else float32_boundary(value)


@njit(cache=True, _nrt=False, inline="always")
def _digits(code: np.int64) -> tuple[np.int64, np.int64, np.int64]:
    """The corrections, -1 to 1, of the three coordinates of a code."""
    return code // 9 - 1, code // 3 % 3 - 1, code % 3 - 1


@uncounted
def _boundaries(
    rounding: int,
    values: NDArray[np.float64],
    start: int,
    distance: NDArray[np.float64],
    step: NDArray[np.int8],
) -> None:
    """Fill distances and steps, ``(N,)`` each, of coordinates from ``values[start]`` on."""
    for j in range(len(distance)):
        distance[j], step[j] = _boundary(rounding, values[start + j])


@njit(cache=True)
def correction_reach(rounding: int, points: NDArray[np.float64], codes: NDArray[np.uint8]) -> float:
    """Return the largest distance at which a coordinate of points ``(M, 3)`` is corrected, -1 if none is."""
    reach = -1.0
    for i in range(len(codes)):
        if codes[i] != _NONE:
            digits = _digits(np.int64(codes[i]))
            for c in range(3):
                if digits[c] != 0:
                    reach = max(reach, _boundary(rounding, points[i, c])[0])
    return reach


@uncounted
def _walk(
    writing: bool,
    state: NDArray[np.int64],
    rounding: int,
    values: NDArray[np.float64],
    reach: float,
    codes: NDArray[np.uint8],
    model: NDArray[np.uint16],
    distance: NDArray[np.float64],
    step: NDArray[np.int8],
    buffer: NDArray[np.uint8],
) -> int:
    """Code corrections ``(M,)`` of coordinates ``(3 M,)``; what no coordinate is near enough for stays as it is: none."""
    block = len(distance) // 3
    for start in range(0, len(codes), block):
        size = min(block, len(codes) - start)
        _boundaries(rounding, values, 3 * start, distance[: 3 * size], step)
        for i in range(size):
            if min(distance[3 * i], distance[3 * i + 1], distance[3 * i + 2]) > reach:
                continue
            digits = _digits(np.int64(codes[start + i]))
            code = np.int64(0)
            for c in range(3):
                digit, near, across = np.int64(0), distance[3 * i + c], np.int64(step[3 * i + c])
                if near <= reach:
                    context = _bucket(near, reach)
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
    points: NDArray[np.float64],
    reach: float,
    codes: NDArray[np.uint8],
    model: NDArray[np.uint16],
    out: NDArray[np.uint8],
) -> int:
    """Encode correction codes 0..26 ``(M,)``; return the bytes written to ``out``, -1 if full.

    Args:
        rounding: MILLIMETRE or FLOAT32, of points ``(M, 3)``; see :mod:`salpcc.stages.lattice.publish`.
    """
    values, coder = points.ravel(), start_coder(True, out)
    scratch = np.empty(3 * BLOCK), np.empty(3 * BLOCK, np.int8)
    return _walk(True, coder, rounding, values, reach, codes.copy(), model, *scratch, out)


@njit(cache=True, nogil=True)
def decode_corrections(
    rounding: int,
    points: NDArray[np.float64],
    reach: float,
    model: NDArray[np.uint16],
    data: NDArray[np.uint8],
) -> tuple[NDArray[np.uint8], bool]:
    """Inverse of :func:`encode_corrections`; the codes and whether the data sufficed."""
    codes = np.full(len(points), _NONE, np.uint8)
    values, coder = points.ravel(), start_coder(False, data)
    scratch = np.empty(3 * BLOCK), np.empty(3 * BLOCK, np.int8)
    return codes, _walk(False, coder, rounding, values, reach, codes, model, *scratch, data) == 0
