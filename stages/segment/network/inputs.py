"""From range-image planes to the network's input: pixel features and the point sets of the 3-D branch."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.segment.network.features import pixel_features
from salpcc.stages.segment.network.point_branch import PointTensors
from salpcc.stages.segment.network.range_image import HEIGHT, INTENSITY, RANGE
from salpcc.stages.segment.network.sampling import PointSets, sample

F32 = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class NetworkInput:
    """One image, ready for the network.

    Attributes:
        features: ``(19, H, W)`` float32.
        points: ``(P, 5)`` float32, the source points of the 3-D branch with height and intensity.
        sets: indices of the 3-D branch; pixels are those of the folded image, row by row.
    """

    features: F32
    points: F32
    sets: PointSets


def network_input(
    planes: F32, fold: int, n_points: int, circular: bool, rng: np.random.Generator | None = None
) -> NetworkInput:
    """Prepare planes ``(6, H, W)``; needs at least one return.

    Args:
        fold, n_points, rng: as in :func:`cloud_input`.
        circular: a whole turn rather than a crop.
    """
    points, sets = cloud_input(planes, fold, n_points, rng)
    return NetworkInput(pixel_features(np.ascontiguousarray(planes), circular), points, sets)


def cloud_input(
    planes: F32, fold: int, n_points: int, rng: np.random.Generator | None = None
) -> tuple[F32, PointSets]:
    """Return the source points ``(P, 5)`` of the 3-D branch of planes ``(6, H, W)``, and its index sets.

    Args:
        fold: columns per folded pixel; its first return stands for it in the 3-D branch.
        n_points: points of the first level.
        rng: as in :func:`~salpcc.stages.segment.network.sampling.sample`.
    """
    flat = planes.reshape(len(planes), -1)
    seen = np.flatnonzero(flat[RANGE])
    shown, asked = _first_returns(flat[RANGE], fold)
    sets = sample(_places(flat, seen), _places(flat, shown), n_points, rng, asked)
    taken = flat[:, seen[sets.source]]
    told = np.concatenate([taken[:3], taken[HEIGHT, None].clip(-2, 6) / 2, taken[INTENSITY, None]])
    return np.ascontiguousarray(told.T), sets


@njit(cache=True)
def _first_returns(ranges: F32, fold: int) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Return the first pixel with a return, of ``ranges`` ``(pixels fold,)``, in each folded one, and whether it has any."""
    first, there = np.arange(0, len(ranges), fold), np.zeros(len(ranges) // fold, np.bool_)
    for i in range(len(there)):
        for k in range(i * fold, (i + 1) * fold):
            if ranges[k] > 0:
                first[i], there[i] = k, True
                break
    return first, there


@njit(cache=True)
def _places(flat: F32, pixels: NDArray[np.int64]) -> F32:
    """Return x, y, z ``(N, 3)`` of some pixels of planes ``(6, H W)``."""
    out = np.empty((len(pixels), 3), np.float32)
    for i in range(len(pixels)):
        for axis in range(3):
            out[i, axis] = flat[axis, pixels[i]]
    return out


def stack(inputs: Sequence[NetworkInput]) -> tuple[torch.Tensor, PointTensors]:
    """Stack inputs of one size into a batch: features ``(B, 19, H, W)`` and point tensors."""
    parts = [as_tensors(one.points, one.sets) for one in inputs]

    def joined(name: str) -> torch.Tensor:
        return torch.cat([getattr(part, name) for part in parts])

    def levels(name: str) -> list[torch.Tensor]:
        return [torch.cat(level) for level in zip(*(getattr(part, name) for part in parts), strict=True)]

    tensors = PointTensors(
        joined("features"),
        levels("centres"),
        levels("groups"),
        levels("parents"),
        levels("weights"),
        joined("pixel_parents"),
        joined("pixel_weights"),
    )
    return torch.from_numpy(np.stack([one.features for one in inputs])), tensors


def as_tensors(points: F32, sets: PointSets) -> PointTensors:
    """Return the 3-D branch's input as a batch of one."""
    return PointTensors(
        _one(points),
        list(map(_one, sets.centres)),
        list(map(_one, sets.groups)),
        list(map(_one, sets.parents)),
        list(map(_one, sets.weights)),
        _one(sets.pixel_parents),
        _one(sets.pixel_weights),
    )


def _one(array: NDArray[Any]) -> torch.Tensor:
    return torch.from_numpy(array)[None]
