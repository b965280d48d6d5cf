"""The network's levels in whole numbers of eight bits, half of what bfloat16 costs: for CPUs that add up such products (VNNI, AMX).

What the levels see and the head are bfloat16 where the CPU has it, else float32. Modalities are not spread like normal
numbers (a sign is ten times as bright as a wall), and what bytes cut off there moved whole objects.

A weight is a whole number of steps, with a step for each output. So is what a pixel holds, with a step for each
channel. No scan is needed to find the steps: batch norm says how a channel is distributed before it is rectified,
mean and deviation, and a byte holds all up to eight deviations above the mean (data-free quantisation, Nagel et al.,
ICCV 2019). Rounding the weights shifts sums by what the means make of it, which the bias takes back.

Scores are those of bfloat16 within 0.0012 (model card). :mod:`.fused` computes the same anywhere.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from salpcc.stages.segment.network.bfloat16 import as_numbers, as_tensor, numbers
from salpcc.stages.segment.network.byte_images import halved, lifted, rounded
from salpcc.stages.segment.network.cloud import Cloud, mixed
from salpcc.stages.segment.network.features import COORDINATES, DEPTH, INTENSITY, folded_features
from salpcc.stages.segment.network.fused import SEAM, Convolution, FusedNetwork, centred, join, normed
from salpcc.stages.segment.network.inputs import cloud_input
from salpcc.stages.segment.network.multimodal import N_CLASSES, SegmentNetwork

F32 = NDArray[np.float32]

# Above the mean, what a byte holds: fewer cut off what is rare, more make its steps coarse (measured).
_DEVIATIONS = 8.0
_ZERO = 128  # the byte of 0 of what is lifted, which has signs


class _Spread(NamedTuple):
    """How channels ``(C,)`` are distributed: as normal numbers of this mean and deviation."""

    mean: Tensor
    deviation: Tensor

    def __add__(self, other: tuple[Tensor, ...]) -> _Spread:  # type: ignore[override]
        return _Spread(self.mean + other[0], torch.hypot(self.deviation, other[1]))

    def rectified(self) -> _Spread:
        """Return mean and deviation of what ReLU leaves."""
        z = self.mean / self.deviation
        below = 0.5 * (1 + torch.erf(z / math.sqrt(2)))
        density = torch.exp(-z * z / 2) / math.sqrt(2 * math.pi)
        mean = self.mean * below + self.deviation * density
        square = (self.mean**2 + self.deviation**2) * below + self.mean * self.deviation * density
        return _Spread(mean, (square - mean**2).clamp_min(1e-12).sqrt())

    def step(self) -> Tensor:
        """Return the step of each channel that lets a byte hold it."""
        return (self.mean + _DEVIATIONS * self.deviation).clamp_min(1e-3) / 255


def _spread(norm: nn.BatchNorm1d | nn.BatchNorm2d) -> _Spread:
    return _Spread(norm.bias, norm.weight.abs().clamp_min(1e-6))


class _Bytes(NamedTuple):
    """What the bytes of an image mean, by channel ``(C,)``: ``step * (byte - zero)``, and what that is in the mean."""

    step: Tensor
    mean: Tensor
    zero: int = 0

    @classmethod
    def of(cls, spread: _Spread, step: Tensor) -> _Bytes:
        """Hold what ReLU leaves of the channels."""
        return cls(step, spread.rectified().mean)


class _Sums:
    """A convolution of bytes to bytes of steps ``target``: rectified, or with a ``zero`` as they are.

    Args:
        weight, bias: ``(outputs, inputs, k, k)`` and ``(outputs,)``, of the numbers that the bytes mean.
        source: what the bytes of the inputs mean.
    """

    def __init__(
        self, weight: Tensor, bias: Tensor | None, source: _Bytes, target: Tensor, zero: int = 0
    ) -> None:
        outputs, _, side, _ = weight.shape
        weight = weight * source.step[:, None, None] / target[:, None, None, None]
        step = weight.abs().amax((1, 2, 3)).clamp_min(1e-12) / 127
        whole = (weight / step[:, None, None, None]).round()
        lost = (weight - whole * step[:, None, None, None]).sum((2, 3))
        self.bias = lost @ (source.mean / source.step)
        if bias is not None:
            self.bias += bias / target
        self.step, self.no_zeros = step, torch.zeros(outputs, dtype=torch.int32)
        self.padding = [side // 2] * 2
        self.zeros = source.zero, zero
        self.weight = torch.ops.onednn.qconv_prepack(
            whole.to(torch.int8), step, 1.0, source.zero, [1, 1], self.padding, [1, 1], 1, None
        )
        self.after = "none" if zero else "relu"

    def __call__(self, image: Tensor) -> Tensor:
        """Map ``(1, inputs, H, W)`` to ``(1, outputs, H, W)``."""
        return torch.ops.onednn.qconv2d_pointwise(
            *self._sum(image), self.bias, [1, 1], self.padding, [1, 1], 1, 1.0, self.zeros[1], torch.uint8,
            self.after, [], None,
        )  # fmt: skip

    def beside(self, image: Tensor, steps: float) -> Tensor:
        """Map the image as a call does, and add it, whose steps are ``steps`` of those of the outputs."""
        added = image.clone(memory_format=torch.preserve_format)
        return torch.ops.onednn.qconv2d_pointwise.binary(
            *self._sum(image), added, self.bias, [1, 1], self.padding, [1, 1], 1, 1.0, self.zeros[1], torch.uint8,
            steps, self.zeros[0], "sum", 1.0, self.after, [], None,
        )  # fmt: skip

    def _sum(self, image: Tensor) -> tuple[Any, ...]:
        return image, 1.0, self.zeros[0], self.weight, self.step, self.no_zeros


def _filter(block: Any, source: _Bytes, target: Tensor) -> _Sums:
    """:class:`~salpcc.stages.segment.network.blocks.MultiKernelFilter`."""
    return _Sums(*normed(centred([block.point.weight, block.around.weight]), block.norm), source, target)


class QuantisedNetwork:
    """Labels the pixels of one whole turn as :class:`~salpcc.stages.segment.network.fused.FusedNetwork` does; on a CPU.

    All channels of a level have steps of their own, and all images of a level the same ones: so they add up.
    """

    def __init__(self, network: SegmentNetwork) -> None:
        self.config = network.config
        whole: Any = FusedNetwork(network)
        self.points, self.fusion, self.head = Cloud(whole.points), whole.fusion, whole.head
        blocks: Any = copy.deepcopy(network).eval().requires_grad_(False)
        last = _spread(blocks.fusion[-1][1])
        down: list[list[_Spread]] = []  # what is expected of the filters of each level
        before = last.rectified()
        for level in blocks.encoders:
            down.append([])
            for block in level:
                down[-1].append(_spread(block.norm) + before if block.residual else _spread(block.norm))
                before = down[-1][-1].rectified()
        up: list[tuple[_Spread, _Spread]] = []  # and of what is lifted and joined, and filtered, bottom up
        for lift, block, skip in zip(
            reversed(blocks.lifts), reversed(blocks.decoders), down[-2::-1], strict=True
        ):
            weight = lift.weight[:, :, 0, 0]
            joined = skip[-1].rectified() + (weight @ before.mean, (weight**2 @ before.deviation**2).sqrt())
            up.append((joined, _spread(block.norm) + joined))
            before = up[-1][1].rectified()
        up.reverse()

        chains = [[*filters, up[i][1]] if i < len(up) else filters for i, filters in enumerate(down)]
        chains[0].append(last)
        steps = [torch.stack([one.step() for one in chain]).amax(0) for chain in chains]
        joint: Any = self.fusion.layers[-1]  # says its sums in steps, the head takes them so
        joint.weight /= steps[0][:, None, None, None]
        joint.bias /= steps[0]
        held = _Bytes.of(last, steps[0])
        self.encoders = []
        for level, spreads, step in zip(blocks.encoders, down, steps, strict=True):
            filters = []
            for block, spread in zip(level, spreads, strict=True):
                filters.append((_filter(block, held, step), block.residual))
                held = _Bytes.of(spread, step)
            self.encoders.append(filters)
        self.decoders = []
        for i in reversed(range(len(up))):
            joined, filtered = up[i]
            lift = _Sums(blocks.lifts[i].weight, None, held, 2 * steps[i], _ZERO)
            lifted_bytes = _Bytes(2 * steps[i], joined.mean, _ZERO)
            self.decoders.append((lift, _filter(blocks.decoders[i], lifted_bytes, steps[i])))
            held = _Bytes.of(filtered, steps[i])
        self.head.weight *= torch.cat([steps[0], steps[0]])[:, None, None]
        dtype = torch.bfloat16 if _can("avx512_bf16", "amx_bf16") else torch.float32
        self.fusion, self.head = _laid_out(self.fusion.to(dtype)), _LaidOut(self.head.to(dtype))
        self.dtype = dtype

    def logits(self, planes: F32) -> F32:
        """Return logits ``(H, W, 19)`` of planes ``(6, H, W)`` of a whole turn, which has a return."""
        _, height, width = planes.shape
        side = SEAM // self.config.fold
        fused = self.fusion(self.shown(planes))
        level = _image(rounded(_array(fused)))
        skips: list[Tensor] = []
        for encoder in self.encoders:
            level = _image(halved(_array(level))) if skips else level
            for layer, residual in encoder:
                level = layer.beside(level, 1.0) if residual else layer(level)
            skips.append(level)
        for (lift, layer), skip in zip(self.decoders, skips[-2::-1], strict=True):
            level = layer.beside(_image(lifted(_array(lift(level)), _array(skip))), 2.0)
        logits = self.head(join([level.to(fused.dtype), fused]))[..., side:-side]
        return logits.permute(0, 2, 3, 1).float().reshape(height, width, N_CLASSES).numpy()

    def shown(self, planes: F32) -> list[Tensor]:
        """Return what the fusion sees, as :meth:`~salpcc.stages.segment.network.fused.FusedNetwork.shown` does, of planes ``(6, H, W)``."""
        fold, side = self.config.fold, SEAM // self.config.fold
        points, sets = cloud_input(planes, fold, self.config.n_points)
        rows = self.points.first_level(points, sets).numpy()
        channels = (*(c * fold for c in (DEPTH, COORDINATES, INTENSITY)), rows.shape[1])
        size = planes.shape[1], planes.shape[2] // fold + 2 * side
        images = [numbers((*size, c), self.dtype) for c in channels]
        folded_features(planes, fold, side, images[:-1])
        mixed(rows, sets.pixel_parents, sets.pixel_weights, side, images[-1])
        return list(map(_image, images))


class _LaidOut(nn.Module):
    """A convolution of :mod:`.fused`, its weights laid out for the processor; its sums are rectified as they are made."""

    def __init__(self, one: Convolution) -> None:
        super().__init__()
        self.padding, self.bias, self.after = [one.side // 2] * 2, one.bias, "relu" if one.relu else "none"
        self.weight = torch.ops.mkldnn._reorder_convolution_weight(
            one.weight, self.padding, [1, 1], [1, 1], 1, None
        )

    def forward(self, image: Tensor) -> Tensor:
        """Map ``(1, inputs, H, W)`` to ``(1, outputs, H, W)``."""
        found: Tensor = torch.ops.mkldnn._convolution_pointwise(
            image, self.weight, self.bias, self.padding, [1, 1], [1, 1], 1, self.after, [], None
        )
        return found


def _laid_out(module: nn.Module) -> nn.Module:
    """Put :class:`_LaidOut` in the place of every convolution of a module."""
    for name, child in module.named_children():
        setattr(module, name, _LaidOut(child) if isinstance(child, Convolution) else _laid_out(child))
    return module


def _image(pixels: NDArray[Any]) -> Tensor:
    """Return ``(H, W, C)``, bytes or :data:`~salpcc.stages.segment.network.bfloat16.Numbers`, as ``(1, C, H, W)``."""
    return as_tensor(pixels)[None].permute(0, 3, 1, 2)


def _array(image: Tensor) -> NDArray[Any]:
    """Inverse of :func:`_image`."""
    return as_numbers(image)[0].transpose(1, 2, 0)


LabellingNetwork = FusedNetwork | QuantisedNetwork


def for_labelling(network: SegmentNetwork, device: str = "cpu") -> LabellingNetwork:
    """Return what a trained network labels by: whole numbers on a CPU that adds up their products, else float32."""
    able = device == "cpu" and _can("avx512_vnni", "avx_vnni", "amx_int8")
    return QuantisedNetwork(network) if able else FusedNetwork(network, device)


def _can(*names: str) -> bool:
    """Tell whether the processor has any of these; an older torch does not know."""
    can: Mapping[str, Any] = getattr(torch.cpu, "get_capabilities", dict)()
    return any(can.get(name) for name in names)
