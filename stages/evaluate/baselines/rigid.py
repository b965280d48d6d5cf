"""Register a scan to the one before it: point-to-plane ICP on a few thousand points, in NumPy.

The baselines that predict between scans need a motion; neither of their papers fixes how it is found. A
motion is a rotation vector and a translation, ``(6,)`` float32, radians and metres.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

Motion = NDArray[np.float32]

STILL: Motion = np.zeros(6, np.float32)
_TARGET, _SOURCE = 20_000, 3_000  # points at most
_NEIGHBOURS = 10
_REACH = (2.0, 1.0, 1.0, 0.5, 0.5, 0.3, 0.3, 0.2, 0.2)  # metres; farther pairs do not count, one round each


def register(source: NDArray[np.floating], target: NDArray[np.floating], start: Motion = STILL) -> Motion:
    """Return the motion that takes ``source`` onto ``target``, both ``(N, 3)`` metres."""
    fixed, moving = _thin(target, _TARGET), _thin(source, _SOURCE)
    if len(fixed) < _NEIGHBOURS or len(moving) < _NEIGHBOURS:
        return start
    tree = cKDTree(fixed, balanced_tree=False)
    normals, flat = _normals(fixed, tree)
    matrix, shift = _matrix(start)
    for reach in _REACH:
        points = moving @ matrix.T + shift
        distance, which = map(np.asarray, tree.query(points, distance_upper_bound=reach))
        good = np.isfinite(distance)
        good[good] &= flat[which[good]]
        if np.count_nonzero(good) < _NEIGHBOURS:
            break
        p, q, n = points[good], fixed[which[good]], normals[which[good]]
        rows = np.hstack([np.cross(p, n), n])
        step = np.linalg.lstsq(rows, ((q - p) * n).sum(axis=1), rcond=None)[0]
        turn, way = _matrix(step)
        matrix, shift = turn @ matrix, turn @ shift + way
    return np.concatenate([_vector(matrix), shift]).astype(np.float32)


def move(points: NDArray[np.floating], motion: Motion) -> NDArray[np.float64]:
    """Move ``(N, 3)`` points; inverse: :func:`move_back`."""
    matrix, shift = _matrix(motion)
    return np.asarray(points.astype(np.float64) @ matrix.T + shift)


def move_back(points: NDArray[np.floating], motion: Motion) -> NDArray[np.float64]:
    """Inverse of :func:`move`."""
    matrix, shift = _matrix(motion)
    return np.asarray((points.astype(np.float64) - shift) @ matrix)


def _thin(points: NDArray[np.floating], count: int) -> NDArray[np.float64]:
    """Take evenly spaced points in file order, so in every direction; the nearest see the car itself."""
    far = points[np.square(points[:, :2]).sum(axis=1) > 4.0].astype(np.float64)
    return far[:: max(1, -(-len(far) // count))]


def _normals(points: NDArray[np.float64], tree: cKDTree) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Normals ``(N, 3)``, and which of them stand on something flat."""
    near = points[tree.query(points, _NEIGHBOURS)[1]]
    centred = near - near.mean(axis=1, keepdims=True)
    values, vectors = np.linalg.eigh(np.einsum("nki,nkj->nij", centred, centred))
    return vectors[:, :, 0], values[:, 0] < 0.05 * values[:, 1]


def _matrix(motion: NDArray[np.floating]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Rotation ``(3, 3)`` by Rodrigues' formula, and translation."""
    vector, shift = motion[:3].astype(np.float64), motion[3:].astype(np.float64)
    angle = float(np.linalg.norm(vector))
    x, y, z = vector / angle if angle > 0 else vector
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross, shift


def _vector(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rotation vector of a rotation by less than half a turn; inverse of :func:`_matrix`."""
    skew = (
        np.array([matrix[2, 1] - matrix[1, 2], matrix[0, 2] - matrix[2, 0], matrix[1, 0] - matrix[0, 1]]) / 2
    )
    sine = float(np.linalg.norm(skew))
    angle = float(np.arctan2(sine, (np.trace(matrix) - 1) / 2))
    return skew * (angle / sine if sine > 0 else 1.0)
