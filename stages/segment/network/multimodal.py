"""The multimodal segmentation network of section IV: three MKRBs, a 3-D branch, fusion, an improved SegNet.

The image enters folded: ``fold`` neighbouring columns become channels of one, and the head unfolds them
again. Nothing is lost by it and a CPU has a quarter of the pixels to walk. The paper does not fold.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

from salpcc.schemas.labels import CLASSES
from salpcc.stages.segment.network.blocks import Conv, MultiKernelFilter, MultiKernelResidual
from salpcc.stages.segment.network.features import COORDINATES, DEPTH, INTENSITY
from salpcc.stages.segment.network.point_branch import PointBranch, PointTensors

N_CLASSES = 19  # SemanticKITTI's; class 0 of CLASSES is unlabelled and never predicted
assert CLASSES[N_CLASSES].name == "traffic-sign"


@dataclass(frozen=True)
class NetworkConfig:
    """Sizes of the network.

    Attributes:
        width: name of the setting.
        fold: columns folded into channels.
        modality, growth, layers: width, dense growth and dense layers of each MKRB.
        points: widths of the 3-D branch, by level.
        n_points: points of its first level in a whole turn.
        fusion: width after eq. (9).
        stages: widths of the encoder, by level; each level halves rows and columns.
        depth: MKFs per level of the encoder.
    """

    width: str
    fold: int
    modality: int
    growth: int
    layers: int
    points: tuple[int, ...]
    n_points: int
    fusion: int
    stages: tuple[int, ...]
    depth: int


WIDTHS = {
    "small": NetworkConfig("small", 4, 32, 16, 2, (32, 64, 96), 4096, 64, (64, 96, 128, 160), 2),
    "wide": NetworkConfig("wide", 4, 64, 32, 2, (64, 128, 192), 4096, 128, (128, 192, 256, 320), 2),
    "paper": NetworkConfig("paper", 1, 32, 16, 3, (64, 128, 256), 4096, 64, (64, 96, 128, 192, 256), 2),
}


class SegmentNetwork(nn.Module):
    """Labels pixels of a range image; ``dropped`` is the share of channels that training leaves out below level 1."""

    dropped = 0.0

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__()
        self.config = config
        self.modalities = nn.ModuleList(
            MultiKernelResidual(channels * config.fold, config.modality, config.growth, config.layers)
            for channels in (DEPTH, COORDINATES, INTENSITY)
        )
        self.points = PointBranch(config.points)
        joined = len(self.modalities) * config.modality + config.points[0]
        self.fusion = nn.Sequential(
            Conv(joined, config.fusion, 1),
            Conv(config.fusion, config.fusion, 1),
            Conv(config.fusion, config.fusion, 1),
        )
        widths = [config.fusion, *config.stages]
        self.encoders = nn.ModuleList(
            _level(a, b, config.depth) for a, b in zip(widths, config.stages, strict=False)
        )
        self.lifts = nn.ModuleList(
            nn.Conv2d(b, a, 1, bias=False) for a, b in zip(config.stages, config.stages[1:], strict=False)
        )
        self.decoders = nn.ModuleList(MultiKernelFilter(a, a) for a in config.stages[:-1])
        self.head = nn.Conv2d(config.stages[0] + config.fusion, N_CLASSES * config.fold, 1)

    def forward(self, features: Tensor, sets: PointTensors) -> Tensor:
        """Map features ``(B, 19, H, W)`` to logits ``(B, 19, H, W)``; W divides by fold times 2 per level."""
        fold = self.config.fold
        parts = torch.split(features, [DEPTH, COORDINATES, INTENSITY], 1)
        images = [block(fold_columns(part, fold)) for block, part in zip(self.modalities, parts, strict=True)]
        cloud = self.points(sets).transpose(1, 2)
        cloud = cloud.reshape(*cloud.shape[:2], *images[0].shape[2:])
        fused = self.fusion(torch.cat([*images, cloud.to(images[0].dtype)], 1))

        skips: list[Tensor] = []
        level = fused
        for encoder in self.encoders:
            level = encoder(functional.max_pool2d(level, 2) if skips else level)
            if skips:
                level = functional.dropout2d(level, self.dropped, self.training)
            skips.append(level)
        for i in range(len(skips) - 2, -1, -1):
            lifted = functional.interpolate(self.lifts[i](level), scale_factor=2, mode="nearest")
            level = self.decoders[i](lifted + skips[i])
        return unfold_columns(self.head(torch.cat([level, fused], 1)), fold)


def _level(inputs: int, outputs: int, depth: int) -> nn.Sequential:
    sizes: Sequence[int] = [inputs] + [outputs] * depth
    return nn.Sequential(*(MultiKernelFilter(a, b) for a, b in itertools.pairwise(sizes)))


def for_cpu(network: SegmentNetwork) -> SegmentNetwork:
    """Lay the weights out as a CPU convolves fastest (channels last); GPUs do not mind."""
    network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    return network


def fold_columns(image: Tensor, fold: int) -> Tensor:
    """Turn ``(B, C, H, W)`` into ``(B, C fold, H, W / fold)``."""
    b, c, h, w = image.shape
    folded = image.reshape(b, c, h, w // fold, fold).permute(0, 1, 4, 2, 3).reshape(b, c * fold, h, w // fold)
    return folded.contiguous(memory_format=torch.channels_last)


def unfold_columns(image: Tensor, fold: int) -> Tensor:
    """Turn ``(B, C fold, H, W)`` into ``(B, C, H, W fold)``; inverse of :func:`fold_columns`."""
    b, c, h, w = image.shape
    return image.reshape(b, c // fold, fold, h, w).permute(0, 1, 3, 4, 2).reshape(b, c // fold, h, w * fold)
