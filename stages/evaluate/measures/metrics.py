"""Measure a decoded scan against its source: section VI-C of the paper, and a proof of the error bound.

Errors are taken point by point in file order, never from a point to its nearest neighbour: a nearest
neighbour hides a point that moved onto its neighbour. Only D_d is defined by nearest neighbours.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

SOURCE_BYTES_PER_POINT = 16  # float32 x, y, z, intensity


@dataclass(frozen=True)
class PointErrors:
    """Errors of a decoded scan; infinite where a coordinate is finite on one side only.

    Attributes:
        distance: ``(N,)`` float64, 3-D distance of each point to its source, metres.
        max_axis: largest absolute difference of any coordinate, metres.
    """

    distance: NDArray[np.float64]
    max_axis: float

    @property
    def maximum(self) -> float:
        """Largest 3-D distance, metres; 0 for an empty scan."""
        return float(self.distance.max(initial=0.0))

    @property
    def sum_of_squares(self) -> float:
        """Sum of the squared distances, square metres."""
        return float(np.square(self.distance).sum())


def compression_rate(compressed: int, points: int) -> float:
    """Return CR, eq. (23), in percent of 16 bytes per input point; 0 for no points."""
    return 100.0 * compressed / (SOURCE_BYTES_PER_POINT * points) if points else 0.0


def bits_per_point(compressed: int, points: int) -> float:
    """Return bits per input point; 0 for no points."""
    return 8.0 * compressed / points if points else 0.0


def point_errors(source: NDArray[np.float32], decoded: NDArray[np.float32]) -> PointErrors:
    """Compare ``(N, 3)`` points pair by pair. Equal bits (NaN and Inf too) are no error.

    Raises:
        ValueError: the two have different shapes.
    """
    if source.shape != decoded.shape:
        raise ValueError(f"{len(decoded)} decoded points do not pair with {len(source)} source points")
    same = source.view(np.uint32) == decoded.view(np.uint32)
    with np.errstate(invalid="ignore"):
        difference = np.abs(decoded.astype(np.float64) - source.astype(np.float64))
    difference[same] = 0.0
    difference[np.isnan(difference)] = np.inf
    distance = np.sqrt(np.square(difference).sum(axis=1))
    return PointErrors(distance, float(difference.max(initial=0.0)))


def same_bits(source: NDArray[np.float32], decoded: NDArray[np.float32]) -> bool:
    """Tell whether two float32 arrays of any shape are equal bit for bit (so NaN equals itself, and 0 is not -0)."""
    return source.shape == decoded.shape and bool(
        np.array_equal(
            np.ascontiguousarray(source).view(np.uint32), np.ascontiguousarray(decoded).view(np.uint32)
        )
    )


def symmetric_distance(source: NDArray[np.float32], decoded: NDArray[np.float32]) -> float:
    """Return D_d of points ``(N, 3)`` and ``(M, 3)``, eq. (24): the mean of both one-way mean *squared* nearest distances (25), square metres.

    Points that are not finite are left out. NaN where one side has no finite point, 0 where neither has.
    """
    from scipy.spatial import cKDTree

    a = source[np.isfinite(source).all(axis=1)].astype(np.float64)
    b = decoded[np.isfinite(decoded).all(axis=1)].astype(np.float64)
    if not len(a) or not len(b):
        return 0.0 if len(a) == len(b) else float("nan")
    there, _ = cKDTree(b, balanced_tree=False).query(a)
    back, _ = cKDTree(a, balanced_tree=False).query(b)
    return float(np.square(there).mean() / 2 + np.square(back).mean() / 2)
