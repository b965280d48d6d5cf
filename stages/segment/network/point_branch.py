"""The 3-D feature extractor of section IV-B: eqs. (5) to (8), on index sets of :mod:`.sampling`."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor, nn

POINT_FEATURES = 5  # x, y, z in metres, height above the ground, intensity
SCALES = (1.0, 2.0, 4.0)  # metres between the points of each level, about


class PointTensors(NamedTuple):
    """A batch of :class:`~salpcc.stages.segment.network.sampling.PointSets`; indices are int64, B images each.

    Attributes:
        features: ``(B, P, 5)`` float32 of the source points.
        centres, groups, parents, weights: lists by level, as in PointSets.
        pixel_parents, pixel_weights: ``(B, pixels, 3)``.
    """

    features: Tensor
    centres: list[Tensor]
    groups: list[Tensor]
    parents: list[Tensor]
    weights: list[Tensor]
    pixel_parents: Tensor
    pixel_weights: Tensor

    def to(self, device: str) -> PointTensors:
        """Return the same on a device."""
        return PointTensors(
            self.features.to(device),
            [one.to(device) for one in self.centres],
            [one.to(device) for one in self.groups],
            [one.to(device) for one in self.parents],
            [one.to(device) for one in self.weights],
            self.pixel_parents.to(device),
            self.pixel_weights.to(device),
        )


def gather(rows: Tensor, index: Tensor) -> Tensor:
    """Take rows ``(B, N, C)`` at ``index`` ``(B, ...)``: ``(B, ..., C)``."""
    flat = index.reshape(len(index), -1)
    taken = torch.gather(rows, 1, flat.unsqueeze(-1).expand(-1, -1, rows.shape[-1]))
    return taken.reshape(*index.shape, rows.shape[-1])


class Convolution1d(nn.Module):
    """1-D convolutions of size 1 with batch norm and ReLU over rows ``(..., C)``."""

    def __init__(self, inputs: int, outputs: Sequence[int]) -> None:
        super().__init__()
        widths = [inputs, *outputs]
        self.linear = nn.ModuleList(
            nn.Linear(a, b, bias=False) for a, b in zip(widths, outputs, strict=False)
        )
        self.norm = nn.ModuleList(nn.BatchNorm1d(b) for b in outputs)

    def forward(self, rows: Tensor) -> Tensor:
        """Map ``(..., inputs)`` to ``(..., outputs[-1])``."""
        flat = rows.reshape(-1, rows.shape[-1])
        for linear, norm in zip(self.linear, self.norm, strict=True):
            flat = torch.relu(norm(linear(flat)))
        return flat.reshape(*rows.shape[:-1], -1)


class PointBranch(nn.Module):
    """Encoder (6): group, convolve, max-pool. Decoder (8): interpolate from three, join, convolve."""

    def __init__(self, widths: Sequence[int]) -> None:
        super().__init__()
        inputs = [POINT_FEATURES - 3, *widths[:-1]]
        self.encoders = nn.ModuleList(
            Convolution1d(3 + a, (b // 2, b)) for a, b in zip(inputs, widths, strict=True)
        )
        self.decoders = nn.ModuleList(Convolution1d(a + b, (a,)) for a, b in itertools.pairwise(widths))

    def forward(self, sets: PointTensors) -> Tensor:
        """Return features ``(B, pixels, widths[0])`` of the queried pixels."""
        points = self.first_level(sets)
        return (gather(points, sets.pixel_parents) * sets.pixel_weights.unsqueeze(-1)).sum(2)

    def first_level(self, sets: PointTensors) -> Tensor:
        """Return features ``(B, M, widths[0])`` of the points of the first level."""
        where = sets.features[..., :3]
        features = sets.features[..., 3:]
        levels = []
        source = where
        for encoder, scale, centres, group in zip(
            self.encoders, SCALES, sets.centres, sets.groups, strict=True
        ):
            here = gather(source, centres)
            offset = (gather(where, group) - here.unsqueeze(2)) / scale
            joined = torch.cat([offset.clamp(-4, 4), gather(features, group)], -1)
            features = encoder(joined).amax(2)
            where = here
            levels.append(features)
        up = levels[-1]
        for level in range(len(levels) - 2, -1, -1):
            weight = sets.weights[level].unsqueeze(-1)
            lifted = (gather(up, sets.parents[level]) * weight).sum(2)
            up = self.decoders[level](torch.cat([levels[level], lifted], -1))
        return up
