"""From lattice points to published points, with the two roundings on the way.

    model --1 mm rounding--> raw --motion--> compensated --float32 rounding--> published

The model and the motion explain nearly every rounding. A coordinate that was rounded the other way
lay close to the rounding boundary, so its correction is all but free for a coder that looks there:
both roundings come with their distance to the boundary.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.ingest.lattice import NO_CORRECTION, corrections
from salpcc.stages.ingest.untwist import forward, on_lattice


def ordered_bits(values: NDArray[np.float32]) -> NDArray[np.int64]:
    """Map float32 to integers in the order of the values, neighbours one apart (-0.0 is -1)."""
    bits = values.view(np.int32).astype(np.int64)
    return np.where(bits < 0, bits ^ 0x7FFFFFFF, bits)


def from_ordered_bits(bits: NDArray[np.int64]) -> NDArray[np.float32]:
    """Inverse of :func:`ordered_bits`."""
    return np.where(bits < 0, bits ^ 0x7FFFFFFF, bits).astype(np.int32).view(np.float32)


@njit(cache=True, error_model="numpy")
def _compensate(
    model: NDArray[np.float64], millimetre: NDArray[np.uint8], motion: NDArray[np.float64], moving: bool
) -> NDArray[np.float64]:
    points = np.empty(model.shape)
    for i in range(len(model)):
        code = np.int64(millimetre[i])
        x = on_lattice(model[i, 0], code // 9 - 1)
        y = on_lattice(model[i, 1], code // 3 % 3 - 1)
        z = on_lattice(model[i, 2], code % 3 - 1)
        if moving:
            x, y, z = forward(x, y, z, motion)
        points[i, 0] = x
        points[i, 1] = y
        points[i, 2] = z
    return points


def compensated_points(
    model: NDArray[np.float64], millimetre: NDArray[np.uint8], motion: NDArray[np.float64] | None
) -> NDArray[np.float64]:
    """Round model points ``(M, 3)`` in metres to 1 mm, correct them, and move them by the motion.

    KITTI stored raw points as float32 before it moved them, so does this. Returns float64 ``(M, 3)``.
    """
    return _compensate(model, millimetre, np.zeros(6) if motion is None else motion, motion is not None)


def published_points(compensated: NDArray[np.float64], ulp: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Round compensated points ``(M, 3)`` to float32 and correct their last bits."""
    points = compensated.astype(np.float32)
    patched = np.flatnonzero(ulp != NO_CORRECTION)
    points[patched] = from_ordered_bits(ordered_bits(points[patched]) + corrections(ulp[patched]))
    return points


@njit(cache=True)
def millimetre_boundary(model: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.int8]]:
    """Distance ``(M, 3)`` in mm to the nearest rounding boundary, and the step across it, +1 or -1."""
    distance = np.empty(model.shape)
    step = np.empty(model.shape, np.int8)
    for i in range(len(model)):
        for c in range(3):
            v = model[i, c] * 1000.0
            off = v - np.rint(v)
            distance[i, c] = 0.5 - abs(off)
            step[i, c] = 1 if off > 0.0 else -1
    return distance, step


def float32_boundary(points: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.int8]]:
    """Distance ``(M, 3)`` in nanometres to the nearest float32 rounding boundary, and the step across it."""
    rounded = points.astype(np.float32)
    off = points - rounded
    half = np.spacing(np.abs(rounded)).astype(np.float64) * 0.5
    return (half - np.abs(off)) * 1e9, np.where(off > 0, np.int8(1), np.int8(-1))
