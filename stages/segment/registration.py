"""How the sensor moved from one scan to the next, for scans that no motion was taken out of.

Scans of a steadily moving sensor are bent alike, so one rigid motion carries each into the next. It is found by
iterated closest points against planes (Chen and Medioni, 1991), looked up on the range image rather than in a tree.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from salpcc.schemas.labels import MOVABLE
from salpcc.stages.lattice.sensor_model import load_sensor
from salpcc.stages.segment.network.range_image import RANGE, nearest_cone, wrapped
from salpcc.stages.segment.segmenter import Segmentation

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

_SPEEDS = -np.arange(
    0.0, 4.01, 0.4
)  # metres that a scan before lies back that a search without a guess begins from
_STEPS = 8
_REACH = (1.2, 0.3)  # metres that matches may be apart, at first and at last
_STILL, _UNTURNED = 0.003, 3e-4  # metres and radians of a correction that is none
_LEAST_MATCHED = 0.4  # share of the points, below which nothing is known
_LEAST_POINTS = 300
_COLUMNS = 3  # pixels to either side that a match is looked for in
_EVERY, _EVERY_LEVEL = 8, 16  # one column of so many is used, and of level ground
_LEVEL, _UPRIGHT = 0.9, 0.5  # z of a normal, from which on and up to which


@njit(cache=True)
def surface_normals(planes: F32) -> F32:
    """Return the unit normal ``(H, W, 3)`` of each pixel of planes ``(6, H, W)``, 0 where its surface has no neighbours."""
    _, rows, columns = planes.shape
    out = np.zeros((rows, columns, 3), np.float32)
    for i in range(1, rows - 1):
        for j in range(columns):
            r = planes[RANGE, i, j]
            left, right = wrapped(j - 3, columns), wrapped(j + 3, columns)
            near = 0.3 + 0.1 * r
            alike = True
            for other in (
                planes[RANGE, i, left],
                planes[RANGE, i, right],
                planes[RANGE, i - 1, j],
                planes[RANGE, i + 1, j],
            ):
                alike = alike and other > 0 and abs(other - r) < near
            if r <= 0 or not alike:
                continue
            ax = planes[0, i, right] - planes[0, i, left]
            ay = planes[1, i, right] - planes[1, i, left]
            az = planes[2, i, right] - planes[2, i, left]
            bx = planes[0, i + 1, j] - planes[0, i - 1, j]
            by = planes[1, i + 1, j] - planes[1, i - 1, j]
            bz = planes[2, i + 1, j] - planes[2, i - 1, j]
            nx, ny, nz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
            norm = np.sqrt(nx * nx + ny * ny + nz * nz)
            if norm > 1e-6:
                out[i, j, 0], out[i, j, 1], out[i, j, 2] = nx / norm, ny / norm, nz / norm
    return out


@njit(cache=True)
def _match(
    points: F64, pose: F64, places: F32, normals: F32, tangent: F64, z0: F64, reach: float
) -> tuple[F64, F64, int, int]:
    """Sum up the normal equations of points ``(N, 3)``, carried by ``pose``, against the ``places`` ``(H, W, 4)`` around theirs.

    Returns ``(6, 6)``, ``(6,)`` of a turn and a shift, how many points found a match, and how many an upright one.
    """
    rows, columns, _ = places.shape
    left = np.zeros((6, 6))
    right = np.zeros(6)
    row_of = np.zeros(6)
    matched = upright = 0
    row = 0
    for n in range(len(points)):
        p, q, r = points[n, 0], points[n, 1], points[n, 2]
        x = pose[0, 0] * p + pose[0, 1] * q + pose[0, 2] * r + pose[0, 3]
        y = pose[1, 0] * p + pose[1, 1] * q + pose[1, 2] * r + pose[1, 3]
        z = pose[2, 0] * p + pose[2, 1] * q + pose[2, 2] * r + pose[2, 3]
        row = nearest_cone(x, y, z, tangent, z0, row)
        if row < 0:
            continue
        centre = int(0.5 * (1.0 - np.arctan2(y, x) / np.pi) * columns)
        nearest = reach * reach
        at_row, at_column = -1, -1
        # No branches but on the whole: which is the nearest follows no pattern.
        for a in range(max(row - 1, 0), min(row + 1, rows - 1) + 1):
            for step in range(-_COLUMNS, _COLUMNS + 1):
                b = wrapped(centre + step, columns)
                dx, dy, dz = places[a, b, 0] - x, places[a, b, 1] - y, places[a, b, 2] - z
                off = dx * dx + dy * dy + dz * dz
                closer = off < nearest
                nearest = off if closer else nearest
                at_row = a if closer else at_row
                at_column = b if closer else at_column
        if at_row < 0:
            continue
        u, v, w = normals[at_row, at_column, 0], normals[at_row, at_column, 1], normals[at_row, at_column, 2]
        if u == 0 and v == 0 and w == 0:
            continue
        matched += 1
        upright += abs(w) < _UPRIGHT
        residual = (
            u * (places[at_row, at_column, 0] - x)
            + v * (places[at_row, at_column, 1] - y)
            + w * (places[at_row, at_column, 2] - z)
        )
        share = 1.0 - (residual / reach) ** 2  # Tukey's
        weight = share * share
        row_of[0], row_of[1], row_of[2] = y * w - z * v, z * u - x * w, x * v - y * u
        row_of[3], row_of[4], row_of[5] = u, v, w
        for i in range(6):
            right[i] += weight * row_of[i] * residual
            for j in range(6):
                left[i, j] += weight * row_of[i] * row_of[j]
    return left, right, matched, upright


def steps_between(
    found: Sequence[Segmentation], joined: Sequence[bool], motions: Sequence[F64 | None]
) -> list[F64 | None]:
    """Return per scan the ``(4, 4)`` that carries the scan before into its frame, None where there is none.

    Args:
        found: what is said of each scan, in order of time; what is movable is left out of the search.
        joined: whether a scan follows the one before it without a gap.
        motions: ``(6,)``, the shift and turn that was taken out of each scan, where one was: the search begins there.
    """
    steps: list[F64 | None] = []
    points = np.zeros((0, 3))
    for one, follows, motion in zip(found, joined, motions, strict=True):
        normals = surface_normals(one.image.planes)
        known = None if motion is None else as_pose(motion)
        last = steps[-1] if steps else None
        step = None
        if steps and follows:
            step = register(one.image.places, normals, points, last if known is None else known)
            step = known if step is None else step
        steps.append(step)
        points = sampled(one.image.places, normals, one.groups[MOVABLE])
    return steps


def as_pose(motion: F64) -> F64:
    """Return the ``(4, 4)`` of a shift and a rotation vector ``(6,)``."""
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_rotvec(motion[3:]).as_matrix()
    pose[:3, 3] = motion[:3]
    return pose


@njit(cache=True)
def sampled(places: F32, normals: F32, movable: F32) -> F64:
    """Return points ``(N, 3)`` of an image to be registered: what is not ``movable`` ``(H, W)`` and on a surface, thinned out."""
    rows, columns, _ = normals.shape
    points = np.empty((rows * columns, 3))
    count = 0
    for i in range(rows):
        for j in range(-i % _EVERY, columns, _EVERY):
            u, v, w = normals[i, j]
            if movable[i, j] >= 0.5 or (u == 0 and v == 0 and w == 0):
                continue
            if abs(w) > _LEVEL and (i + j) % _EVERY_LEVEL:
                continue
            for axis in range(3):
                points[count, axis] = places[i, j, axis]
            count += 1
    return points[:count].copy()


def register(places: F32, normals: F32, points: F64, guess: F64 | None = None) -> F64 | None:
    """Return the pose ``(4, 4)`` that carries ``points`` ``(N, 3)`` of a scan into the frame of a neighbour's image.

    Args:
        places, normals: ``(H, W, 4)`` and ``(H, W, 3)`` of the neighbour.
        guess: where the search begins; without it, at several speeds straight ahead.

    Returns:
        None where too few points match.
    """
    if len(points) < _LEAST_POINTS:
        return None
    sensor = load_sensor("hdl64e")
    grid = places, normals, np.tan(sensor.theta), sensor.z0
    pose = guess if guess is not None else _nearest_speed(points, *grid)
    matched = 0
    reaches = np.geomspace(*_REACH, _STEPS).tolist()
    while reaches:
        reach = reaches.pop(0)
        left, right, matched, _ = _match(points, pose, *grid, reach)
        if matched < _LEAST_MATCHED * len(points):
            break
        turn = np.linalg.solve(left + 1e-6 * np.eye(6), right)
        pose = as_pose(np.concatenate([turn[3:], turn[:3]])) @ pose
        if np.abs(turn[3:]).max() < _STILL and np.abs(turn[:3]).max() < _UNTURNED:
            reaches = reaches[-1:]  # the last reach is the finest
    return pose if matched >= _LEAST_MATCHED * len(points) else None


def _nearest_speed(points: F64, places: F32, normals: F32, tangent: F64, z0: F64) -> F64:
    """Return the speed straight ahead at which most walls match; the rings on level ground match at any."""
    best, most = np.eye(4), -1
    some = np.ascontiguousarray(points[::2])
    for speed in _SPEEDS:
        pose = np.eye(4)
        pose[0, 3] = speed
        upright = _match(some, pose, places, normals, tangent, z0, _REACH[1])[3]
        if upright > most:
            best, most = pose, upright
    return best
