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


@njit(cache=True)
def correction_reach(distance: NDArray[np.float64], codes: NDArray[np.uint8]) -> float:
    """Return the largest distance at which a coordinate is corrected, -1 if none is."""
    reach = -1.0
    for i in range(len(codes)):
        if codes[i] != _NONE:
            code = np.int64(codes[i])
            digits = (code // 9 - 1, code // 3 % 3 - 1, code % 3 - 1)
            for c in range(3):
                if digits[c] != 0 and distance[i, c] > reach:
                    reach = distance[i, c]
    return reach


@uncounted
def _walk(
    writing: bool,
    state: NDArray[np.int64],
    distance: NDArray[np.float64],
    step: NDArray[np.int8],
    reach: float,
    codes: NDArray[np.uint8],
    model: NDArray[np.uint16],
    buffer: NDArray[np.uint8],
) -> int:
    for i in range(len(codes)):
        given = np.int64(codes[i])
        digits = (given // 9 - 1, given // 3 % 3 - 1, given % 3 - 1)
        code = np.int64(0)
        for c in range(3):
            digit = np.int64(0)
            if distance[i, c] <= reach:
                context = _bucket(distance[i, c], reach)
                if code_bit(writing, state, buffer, model, context, 1 if digits[c] != 0 else 0):
                    back = code_bit(
                        writing, state, buffer, model, _ACROSS, 1 if digits[c] != step[i, c] else 0
                    )
                    digit = np.int64(-step[i, c] if back else step[i, c])
            code = code * 3 + digit + 1
        codes[i] = code
    return finish_coder(writing, state, buffer)


@njit(cache=True)
def encode_corrections(
    distance: NDArray[np.float64],
    step: NDArray[np.int8],
    reach: float,
    codes: NDArray[np.uint8],
    model: NDArray[np.uint16],
    out: NDArray[np.uint8],
) -> int:
    """Encode correction codes 0..26 ``(M,)``; return the bytes written to ``out``, -1 if full.

    Args:
        distance, step: ``(M, 3)``, see :mod:`salpcc.stages.lattice.publish`.
    """
    return _walk(True, start_coder(True, out), distance, step, reach, codes.copy(), model, out)


@njit(cache=True, nogil=True)
def decode_corrections(
    distance: NDArray[np.float64],
    step: NDArray[np.int8],
    reach: float,
    model: NDArray[np.uint16],
    data: NDArray[np.uint8],
) -> tuple[NDArray[np.uint8], bool]:
    """Inverse of :func:`encode_corrections`; the codes and whether the data sufficed."""
    codes = np.full(len(distance), _NONE, np.uint8)
    return codes, _walk(False, start_coder(False, data), distance, step, reach, codes, model, data) == 0
