"""From range-image planes to the network's input: pixel features and the point sets of the 3-D branch."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from salpcc.stages.segment.features import pixel_features
from salpcc.stages.segment.point_branch import PointTensors
from salpcc.stages.segment.range_image import HEIGHT, INTENSITY, RANGE
from salpcc.stages.segment.sampling import PointSets, sample

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
        fold: columns per folded pixel; its first return stands for it in the 3-D branch.
        n_points: points of the first level.
        circular: a whole turn rather than a crop.
        rng: as in :func:`~salpcc.stages.segment.sampling.sample`.
    """
    _, height, width = planes.shape
    folded = planes.reshape(len(planes), height, width // fold, fold)
    first = (folded[RANGE] > 0).argmax(axis=2)
    stands = np.take_along_axis(folded, first[None, :, :, None], axis=3)[..., 0].reshape(len(planes), -1)
    seen = planes[:, planes[RANGE] > 0]
    asked = stands[RANGE] > 0
    sets = sample(np.ascontiguousarray(seen[:3].T), np.ascontiguousarray(stands[:3].T), n_points, rng, asked)
    taken = seen[:, sets.source]
    points = np.concatenate([taken[:3], taken[HEIGHT, None].clip(-2, 6) / 2, taken[INTENSITY, None]])
    return NetworkInput(
        pixel_features(np.ascontiguousarray(planes), circular), np.ascontiguousarray(points.T), sets
    )


def stack(inputs: Sequence[NetworkInput]) -> tuple[torch.Tensor, PointTensors]:
    """Stack inputs of one size into a batch: features ``(B, 19, H, W)`` and point tensors."""
    sets = [one.sets for one in inputs]

    def levels(name: str) -> list[torch.Tensor]:
        return [_stacked(list(level)) for level in zip(*(getattr(s, name) for s in sets), strict=True)]

    tensors = PointTensors(
        _stacked([one.points for one in inputs]),
        levels("centres"),
        levels("groups"),
        levels("parents"),
        levels("weights"),
        _stacked([s.pixel_parents for s in sets]),
        _stacked([s.pixel_weights for s in sets]),
    )
    return _stacked([one.features for one in inputs]), tensors


def _stacked(arrays: Sequence[NDArray[np.generic]]) -> torch.Tensor:
    return torch.from_numpy(np.stack(arrays))
