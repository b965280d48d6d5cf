"""Refine given poses: the way that registration found, with the scale and the slow drift of the given ones.

From scan to scan registration is good to a centimetre and given poses need not be; over hundreds of metres it drifts and they
do not. So the found trajectory is laid over the given one, and what then still lies between them is spread along the way, if
the scans fit one another as well so.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import small_gicp
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from salpcc.stages.mapping.drive.odometry import THIN, Thinned
from salpcc.stages.mapping.drive.poses import move

F64 = NDArray[np.float64]

SPOTS = 24  # scans at most by which poses are judged
BACK = (1, 4, 10, 20)  # scans before such a one, that it must fit
_SPREAD = 50.0  # metres of way: the standard deviation over which drift is spread
_CHORD = 10.0  # metres of way, over which scales are compared
_SCALE_SLACK = 0.01  # registration's own scale is no better
_HARDLY = 1.1  # times the least residual, up to which poses that are nearer to the given ones are taken


@dataclass(frozen=True)
class PoseCheck:
    """How well poses fit the scans.

    Attributes:
        given_residual_m: median distance of a scan's points to the surfaces that the scans before it saw, at given poses.
        residual_m: the same at the poses that the map is made with.
        scale: length of the given way by that of the found one.
        apart_m, apart_deg: between two scans' given poses and those found, median over groups.
        refined: whether the map is made with refined poses.
    """

    given_residual_m: float | None
    residual_m: float | None
    scale: float | None
    apart_m: float | None
    apart_deg: float | None
    refined: bool


def candidates(found: F64, given: F64) -> tuple[dict[str, F64], float]:
    """Return trajectories ``(n, 4, 4)`` to choose from, the most faithful to the given one first, and that one's scale.

    ``given`` itself; ``spread``: the found one, with what lies between the two spread along the way; ``laid``: the found one as
    it is, laid over the given one. A scale that is off by more than registration can be is taken out of the given one before,
    about its first pose.
    """
    scale = _scale(found[:, :3, 3], given[:, :3, 3])
    target = given[:, :3, 3]
    if abs(scale - 1.0) > _SCALE_SLACK:
        target = target[0] + (target - target[0]) / scale
    turns = Rotation.from_matrix(given[:, :3, :3] @ found[:, :3, :3].transpose(0, 2, 1))
    whole = turns.mean()
    laid = np.tile(np.eye(4), (len(found), 1, 1))
    laid[:, :3, :3] = whole.as_matrix() @ found[:, :3, :3]
    laid[:, :3, 3] = whole.apply(found[:, :3, 3])
    laid[:, :3, 3] += (target - laid[:, :3, 3]).mean(axis=0)
    drift = _smooth(
        np.column_stack([target - laid[:, :3, 3], (turns * whole.inv()).as_rotvec()]), _way(found)
    )
    spread = laid.copy()
    spread[:, :3, :3] = Rotation.from_rotvec(drift[:, 3:]).as_matrix() @ laid[:, :3, :3]
    spread[:, :3, 3] += drift[:, :3]
    return {"given": given, "spread": spread, "laid": laid}, scale


def choose(residuals: dict[str, float | None]) -> str:
    """Choose the first of some trajectories whose residual is hardly above the least."""
    known = {name: value for name, value in residuals.items() if value is not None}
    if not known:
        return next(iter(residuals))
    return next(name for name, value in known.items() if value <= _HARDLY * min(known.values()))


def _scale(found: F64, given: F64) -> float:
    """Compare the lengths of straight stretches of two ways ``(n, 3)``; 1 where nobody drove far."""
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(found, axis=0), axis=1))])
    ends = np.searchsorted(way, way + _CHORD)
    starts = np.flatnonzero(ends < len(way))
    if not len(starts):
        return 1.0
    ends = ends[starts]
    ratio = np.linalg.norm(given[ends] - given[starts], axis=1) / np.linalg.norm(
        found[ends] - found[starts], axis=1
    )
    return float(np.median(ratio))


def _way(poses: F64) -> F64:
    steps = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(steps)])


def _smooth(off: F64, way: F64) -> F64:
    """Fit a line to ``off`` ``(n, 6)`` around each place of the way, near places weighing most."""
    weight = (
        np.gradient(way) + 1e-3 if len(way) > 1 else np.ones(1)
    )  # where one stands, many scans say the same
    out = np.empty_like(off)
    for k in range(len(way)):
        near = np.abs(way - way[k]) < 4 * _SPREAD
        x = way[near] - way[k]
        w = weight[near] * np.exp(-0.5 * np.square(x / _SPREAD))
        total, first = w.sum(), w @ x
        across = w @ np.square(x) - first**2 / total
        slope = (w * (x - first / total)) @ off[near] / across if across > 1e-6 * total else 0.0
        out[k] = w @ off[near] / total - slope * first / total
    return out


def spots_of(n: int) -> list[int]:
    """Choose the scans of ``n`` by which poses are judged, evenly spread."""
    first = min(BACK[-1], n - 1)
    return sorted({int(k) for k in np.linspace(first, n - 1, min(SPOTS, n)).round()} - {0})


def residual(
    clouds: Callable[[int], Thinned], spots: Sequence[int], poses: F64, motions: F64
) -> float | None:
    """Return the median distance, metres, of scans' points to the surfaces that scans before saw; None without any.

    Args:
        clouds: gives the scan of a place in the drive.
        poses, motions: ``(n, 4, 4)`` and ``(n, 6)`` of all scans.
    """
    medians = []
    for k in spots:
        placed = [move(clouds(i).at(motions[i]), poses[i]) for i in (k - b for b in BACK) if i >= 0]
        if not sum(map(len, placed)):
            continue
        seen = small_gicp.preprocess_points(np.concatenate(placed), 0.01, 12, 1)[0]
        places, normals = (np.asarray(part())[:, :3] for part in (seen.points, seen.normals))
        points = move(clouds(k).at(motions[k]), poses[k])
        distance, at = cKDTree(places).query(points, distance_upper_bound=1.5 * THIN)
        near = np.isfinite(distance)
        if near.any():
            i = np.asarray(at)[near]
            medians.append(np.median(np.abs(np.einsum("ij,ij->i", points[near] - places[i], normals[i]))))
    return float(np.median(medians)) if medians else None
