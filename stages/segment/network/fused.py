"""The network as labelling runs it: the sums of :mod:`.multimodal`, laid out for a processor's matrix products.

Batch norms are inside the weights before them. Kernels of 1 and 3 pixels become one of 3, those of 5 and 7 one of 7
(sixteen channels cost what eight do). The channels of a pixel lie together, and the head's are ordered so that
unfolding moves nothing. :mod:`.quantised` does the same in whole numbers.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from salpcc.stages.segment.network.features import COORDINATES, DEPTH, INTENSITY
from salpcc.stages.segment.network.inputs import network_input, stack
from salpcc.stages.segment.network.multimodal import N_CLASSES, SegmentNetwork, fold_columns
from salpcc.stages.segment.network.point_branch import PointTensors

F32 = NDArray[np.float32]

# Columns repeated at both ends, so that the seam behind the vehicle is seen whole; divides by every fold and level.
SEAM = 64


class FusedNetwork(nn.Module):
    """Labels the pixels of one whole turn; a copy of a trained network, which it does not follow.

    Args:
        network: what is computed.
        device: where.
    """

    def __init__(self, network: SegmentNetwork, device: str = "cpu") -> None:
        super().__init__()
        self.config = network.config
        self.device = device
        blocks: Any = copy.deepcopy(network).eval().requires_grad_(False)
        self.fusion = Fusion(blocks)
        self.encoders = nn.ModuleList(nn.Sequential(*map(_Filter, level)) for level in blocks.encoders)
        self.lifts = nn.ModuleList(Convolution(lift.weight, None) for lift in blocks.lifts)
        self.decoders = nn.ModuleList(map(_Filter, blocks.decoders))
        by_column = torch.arange(N_CLASSES * self.config.fold).reshape(N_CLASSES, -1).T.ravel()
        self.head = Convolution(blocks.head.weight[by_column], blocks.head.bias[by_column])
        self.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.points = blocks.points
        for half in (self.points.encoders, self.points.decoders):
            for i, block in enumerate(half):
                half[i] = _Rows(block)
        self.to(device)

    def logits(self, planes: F32) -> F32:
        """Return logits ``(H, W, 19)`` of planes ``(6, H, W)`` of a whole turn, which has a return."""
        features, sets = stack([network_input(planes, self.config.fold, self.config.n_points, circular=True)])
        found: F32 = self(features.to(self.device), sets.to(self.device)).cpu().numpy()
        return found

    def forward(self, features: Tensor, sets: PointTensors) -> Tensor:
        """Map features ``(1, 19, H, W)`` and point sets of a whole turn to logits ``(H, W, 19)`` float32."""
        side = SEAM // self.config.fold
        _, _, height, width = features.shape
        fused = self.fusion(self.shown(features, sets))
        skips: list[Tensor] = []
        level = fused
        for encoder in self.encoders:
            level = encoder(functional.max_pool2d(level, 2) if skips else level)
            skips.append(level)
        for i in range(len(skips) - 2, -1, -1):
            lifted = functional.interpolate(self.lifts[i](level), scale_factor=2, mode="nearest")
            level = self.decoders[i](lifted.add_(skips[i]))
        logits = self.head(join([level, fused])).permute(0, 2, 3, 1)
        return logits[0, :, side:-side].reshape(height, width, N_CLASSES).contiguous()

    def shown(self, features: Tensor, sets: PointTensors) -> list[Tensor]:
        """Return what the fusion sees ``(1, C, H, W / fold)``, with columns repeated: depth, coordinates, intensity, the 3-D branch."""
        fold = self.config.fold
        parts = [fold_columns(part, fold) for part in features.split([DEPTH, COORDINATES, INTENSITY], 1)]
        cloud = self.points(sets).reshape(1, *parts[0].shape[2:], -1).permute(0, 3, 1, 2)
        side = SEAM // fold
        return [torch.cat([image[..., -side:], image, image[..., :side]], 3) for image in (*parts, cloud)]


class Fusion(nn.Module):
    """The images of the modalities and what the points say, joined: eq. (9)."""

    def __init__(self, blocks: Any) -> None:
        super().__init__()
        self.modalities = nn.ModuleList(map(_Residual, blocks.modalities))
        self.layers = nn.Sequential(*map(_conv, blocks.fusion))

    def forward(self, images: Sequence[Tensor]) -> Tensor:
        """Map the images ``(1, c, H, W)`` of depth, coordinates and intensity, and of what the points say, to one ``(1, C, H, W)``."""
        seen = [block(image) for block, image in zip(self.modalities, images[:-1], strict=True)]
        fused: Tensor = self.layers(join([*seen, images[-1]]))
        return fused


class Convolution(nn.Module):
    """A convolution; one of a single pixel is a product of matrices, which a CPU does faster."""

    def __init__(self, weight: Tensor, bias: Tensor | None, relu: bool = False) -> None:
        super().__init__()
        self.side = weight.shape[-1]
        self.weight = nn.Parameter(weight, requires_grad=False)
        self.bias = None if bias is None else nn.Parameter(bias, requires_grad=False)
        self.relu = relu

    def forward(self, image: Tensor) -> Tensor:
        """Map ``(1, inputs, H, W)`` to ``(1, outputs, H, W)``."""
        if self.side > 1:
            out = functional.conv2d(image, self.weight, self.bias, padding=self.side // 2)
        else:
            out = functional.linear(image.permute(0, 2, 3, 1), self.weight[:, :, 0, 0], self.bias).permute(
                0, 3, 1, 2
            )
        return out.relu_() if self.relu else out


class _Residual(nn.Module):
    """:class:`~salpcc.stages.segment.network.blocks.MultiKernelResidual`."""

    def __init__(self, block: Any) -> None:
        super().__init__()
        norm, out = block.norm[0], block.out[0]
        weight, bias = normed(centred([conv.weight for conv in block.parallel]), norm)
        near = sum(len(conv.weight) for conv in block.parallel if conv.weight.shape[-1] <= 3)
        self.near = Convolution(weight[:near, :, 2:-2, 2:-2], bias[:near], relu=True)
        self.far = Convolution(weight[near:], bias[near:], relu=True)
        self.dense = nn.ModuleList(map(_conv, block.dense))
        layered = block.last.weight.shape[1]
        weight, bias = normed(torch.cat([block.last.weight, block.shortcut.weight], 1), out)
        self.last = Convolution(weight[:, :layered], bias)
        self.shortcut = Convolution(weight[:, layered:], None)

    def forward(self, image: Tensor) -> Tensor:
        """Map ``(1, inputs, H, W)`` to ``(1, width, H, W)``."""
        layered = join([self.near(image), self.far(image)])
        for layer in self.dense:
            layered = join([layered, layer(layered)])
        return self.last(layered).add_(self.shortcut(image)).relu_()


class _Filter(nn.Module):
    """:class:`~salpcc.stages.segment.network.blocks.MultiKernelFilter`."""

    def __init__(self, block: Any) -> None:
        super().__init__()
        weight = centred([block.point.weight, block.around.weight])
        self.both = Convolution(*normed(weight, block.norm))
        self.residual = block.residual

    def forward(self, image: Tensor) -> Tensor:
        """Map ``(1, inputs, H, W)`` to ``(1, outputs, H, W)``."""
        both = self.both(image)
        return (both.add_(image) if self.residual else both).relu_()


class _Rows(nn.Module):
    """:class:`~salpcc.stages.segment.network.point_branch.Convolution1d`."""

    def __init__(self, block: Any) -> None:
        super().__init__()
        for i, (linear, norm) in enumerate(zip(block.linear, block.norm, strict=True)):
            weight, bias = normed(linear.weight, norm)
            block.linear[i] = nn.Linear(*weight.T.shape).requires_grad_(False)
            block.linear[i].weight.copy_(weight)
            block.linear[i].bias.copy_(bias)
        self.linear = block.linear

    def forward(self, rows: Tensor) -> Tensor:
        """Map ``(..., inputs)`` to ``(..., outputs[-1])``."""
        for linear in self.linear:
            rows = linear(rows).relu_()
        return rows


def _conv(block: Any) -> Convolution:
    """:class:`~salpcc.stages.segment.network.blocks.Conv`."""
    conv, norm, _ = block
    return Convolution(*normed(conv.weight, norm), relu=True)


def normed(weight: Tensor, norm: nn.BatchNorm1d | nn.BatchNorm2d) -> tuple[Tensor, Tensor]:
    """Return weights ``(outputs, ...)`` and bias ``(outputs,)`` that do what the batch norm behind does, too."""
    assert norm.running_mean is not None and norm.running_var is not None
    scale = norm.weight / torch.sqrt(norm.running_var + norm.eps)
    return weight * scale.reshape(-1, *[1] * (weight.ndim - 1)), norm.bias - norm.running_mean * scale


def centred(kernels: Sequence[Tensor]) -> Tensor:
    """Join odd kernels ``(outputs, inputs, k, k)`` over the outputs, each in the middle of the largest."""
    side = max(kernel.shape[-1] for kernel in kernels)
    return torch.cat([functional.pad(kernel, [(side - kernel.shape[-1]) // 2] * 4) for kernel in kernels])


def join(images: Sequence[Tensor]) -> Tensor:
    """Join images over their channels, which lie together."""
    return torch.cat([image.permute(0, 2, 3, 1) for image in images], 3).permute(0, 3, 1, 2)
