"""Score a map against labels: SA, DA, AA as in the KTH DynamicMap benchmark, PR, RR, F1 as in ERASOR.

A labelled point is in the map where the map has anything in its voxel. SA is the share of static points that
are, DA the share of dynamic points that are not, AA the root of their product. On voxels of 0.2 m, each static or
dynamic by the majority of its labelled points: PR is the share of static voxels that the map has, RR of dynamic
ones that it has not, F1 their harmonic mean. Points without a label (0, 1, 52, 99) count nowhere; where labels are
made of boxes, 99 is what lies in none of them, and static.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from salpcc.stages.mapping.voxel import coarser, keys_of

F64 = NDArray[np.float64]
Keys = NDArray[np.int64]

STATIC, MOVABLE_STILL, MOVING, UNKNOWN = 0, 1, 2, 3  # what a labelled point is
_ERASOR = 0.2  # metres
_UNLABELLED = (0, 1, 52, 99)
_OTHER_OBJECT = 99
_MOVABLE_IDS = (10, 11, 13, 15, 16, 18, 20, 30, 31, 32)
_FIRST_MOVING = 252


def truth_of_labels(labels: NDArray[np.uint32]) -> NDArray[np.uint8]:
    """Tell what each point of a scan is from its SemanticKITTI label ``(N,)``; the upper 16 bits do not matter.

    A scan that names nothing static, no ground even, was labelled by boxes around what may move: other-object (99) is
    then all that the labeller saw in no box, and static.
    """
    ids = labels & 0xFFFF
    out = np.full(len(ids), STATIC, np.uint8)
    out[np.isin(ids, _UNLABELLED)] = UNKNOWN
    out[np.isin(ids, _MOVABLE_IDS)] = MOVABLE_STILL
    out[ids >= _FIRST_MOVING] = MOVING
    if not (out == STATIC).any():
        out[ids == _OTHER_OBJECT] = STATIC
    return out


@dataclass(frozen=True, eq=False)
class Truth:
    """Labelled points by voxel: keys ``(V,)`` ascending, and points ``(V, 3)`` static, standing, moving."""

    keys: Keys
    points: NDArray[np.int64]

    @classmethod
    def of_points(cls, xyz: F64, truth: NDArray[np.uint8], voxel: float) -> Truth:
        """Count points ``(N, 3)`` of the map's frame by voxel."""
        known = truth != UNKNOWN
        keys, at = np.unique(keys_of(xyz[known], voxel), return_inverse=True)
        counts = np.bincount(at * 3 + truth[known], minlength=3 * len(keys)).reshape(-1, 3)
        return cls(keys, counts)

    @classmethod
    def together(cls, parts: list[Truth]) -> Truth:
        """Add up the counts of several."""
        if not parts:
            return cls(np.empty(0, np.int64), np.empty((0, 3), np.int64))
        keys, at = np.unique(np.concatenate([part.keys for part in parts]), return_inverse=True)
        counts = np.zeros((len(keys), 3), np.int64)
        np.add.at(counts, at, np.concatenate([part.points for part in parts]))
        return cls(keys, counts)


@dataclass(frozen=True)
class Tally:
    """Counts that add up over tiles: ``points`` per kind and, of these, ``in_map``; the same for 0.2 m voxels.

    Voxels come twice: static against moving, without those of standing movables, which belong to neither; and
    static against all movable.
    """

    points: tuple[int, int, int] = (0, 0, 0)
    in_map: tuple[int, int, int] = (0, 0, 0)
    moving_voxels: tuple[int, int] = (0, 0)  # static, moving
    moving_in_map: tuple[int, int] = (0, 0)
    movable_voxels: tuple[int, int] = (0, 0)  # static, movable
    movable_in_map: tuple[int, int] = (0, 0)

    def __add__(self, other: Tally) -> Tally:
        """Add counts up."""
        return Tally(
            *(
                tuple(a + b for a, b in zip(getattr(self, f.name), getattr(other, f.name), strict=True))
                for f in fields(self)
            )
        )


def tally(truth: Truth, map_keys: Keys, voxel: float) -> Tally:
    """Count what of ``truth`` is in a map whose occupied voxels are ``map_keys`` (any order)."""
    inside = np.isin(truth.keys, map_keys)
    factor = max(1, round(_ERASOR / voxel))
    wide, at = np.unique(coarser(truth.keys, factor), return_inverse=True)
    counts = np.zeros((len(wide), 3), np.int64)
    np.add.at(counts, at, truth.points)
    wide_in = np.isin(wide, coarser(map_keys, factor))
    still, standing, moving = counts.T
    by_moving = (moving > still) & (moving >= standing)
    by_still = (still >= moving) & (still >= standing)
    by_movable = standing + moving > still
    return Tally(
        _three(truth.points.sum(axis=0)),
        _three(truth.points[inside].sum(axis=0)),
        _two(by_still, by_moving),
        _two(by_still & wide_in, by_moving & wide_in),
        _two(~by_movable, by_movable),
        _two(~by_movable & wide_in, by_movable & wide_in),
    )


def quality(counts: Tally) -> dict[str, dict[str, float | None]]:
    """Turn counts into SA, DA, AA, PR, RR, F1: of ``moving`` things, and of all ``movable`` ones.

    Whether a standing car belongs in a map is the task's choice: to ``moving`` it counts nowhere, to ``movable`` it
    is dynamic. None where there is nothing to count.
    """
    still, standing, moving = counts.points
    still_in, standing_in, moving_in = counts.in_map
    return {
        "moving": _measures(
            _share(still_in, still),
            _share(moving - moving_in, moving),
            counts.moving_voxels,
            counts.moving_in_map,
        ),
        "movable": _measures(
            _share(still_in, still),
            _share(standing + moving - standing_in - moving_in, standing + moving),
            counts.movable_voxels,
            counts.movable_in_map,
        ),
    }


def _measures(
    sa: float | None, da: float | None, voxels: tuple[int, int], in_map: tuple[int, int]
) -> dict[str, float | None]:
    pr = _share(in_map[0], voxels[0])
    rr = _share(voxels[1] - in_map[1], voxels[1])
    f1 = None if pr is None or rr is None or pr + rr == 0 else 2 * pr * rr / (pr + rr)
    aa = None if sa is None or da is None else float(np.sqrt(sa * da))
    return {"SA": sa, "DA": da, "AA": aa, "PR": pr, "RR": rr, "F1": f1}


def _share(part: int, whole: int) -> float | None:
    return part / whole if whole else None


def _two(a: NDArray[np.bool_], b: NDArray[np.bool_]) -> tuple[int, int]:
    return int(np.count_nonzero(a)), int(np.count_nonzero(b))


def _three(values: NDArray[np.int64]) -> tuple[int, int, int]:
    return int(values[0]), int(values[1]), int(values[2])
