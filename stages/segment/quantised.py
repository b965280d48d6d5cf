"""The network in whole numbers of eight bits, half of what bfloat16 costs: for CPUs that add up such products (VNNI, AMX).

A weight is a whole number of steps, with a step for each output. So is what a pixel holds, with a step for each
channel. No scan is needed to find the steps: batch norm says how a channel is distributed before it is rectified,
mean and deviation, and a byte holds all up to eight deviations above the mean (data-free quantisation, Nagel et al.,
ICCV 2019). Rounding the weights shifts sums by what the means make of it, which the bias takes back.

Scores stay within 0.0025 but where a dozen points decide (model card). :mod:`.fused` computes the same anywhere.
"""

from __future__ import annotations

import copy
import functools
import itertools
import math
import operator
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from salpcc.stages.segment.byte_images import halved, lifted, mixed, to_bytes
from salpcc.stages.segment.cloud import Cloud
from salpcc.stages.segment.features import COORDINATES, DEPTH, INTENSITY, pixel_features
from salpcc.stages.segment.fused import SEAM, FusedNetwork, centred, join, normed
from salpcc.stages.segment.inputs import cloud_input
from salpcc.stages.segment.network import N_CLASSES, SegmentNetwork

F32 = NDArray[np.float32]

# Above the mean, what a byte holds: fewer cut off what is rare, more make its steps coarse (measured).
_DEVIATIONS = 8.0
_ZERO = 128  # the byte of 0 where numbers have signs: of features, and of what is lifted
_PARTS = tuple(itertools.pairwise(itertools.accumulate([0, DEPTH, COORDINATES, INTENSITY])))
# The largest that a feature becomes, and its mean in streets, in the order of :mod:`.features`.
_FEATURES = torch.tensor(
    [
        [1.65, 1.6, 1, 1, 1, 1, 1, 3.2, 3.2, 3, 3, 1, 1, 1, 1, 1, 2, 1, 2],
        [0.7, 0.3, 0, 0, 0.3, -0.3, 0.85, 0, 0, -0.35, 0.2, 0.35, -0.2, 0, 0.5, 0.75, 0.5, 0.45, 0.5],
    ]
)


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
    zero: Tensor
    mean: Tensor

    @classmethod
    def of(cls, spread: _Spread, step: Tensor | None = None) -> _Bytes:
        """Hold what ReLU leaves of the channels."""
        step = spread.step() if step is None else step
        return cls(step, torch.zeros_like(step), spread.rectified().mean)

    def __or__(self, other: _Bytes) -> _Bytes:
        return _Bytes(*map(torch.cat, zip(self, other, strict=True)))


class _Sums:
    """A convolution of bytes; its outputs are bytes of steps ``target`` above ``zero``, or float32 without a target.

    Args:
        weight, bias: ``(outputs, inputs, k, k)`` and ``(outputs,)``, of the numbers that the bytes mean.
        source: what the bytes of the inputs mean; where ``k`` > 1 their zeros are one number, which borders are padded by.
    """

    def __init__(
        self,
        weight: Tensor,
        bias: Tensor | None,
        source: _Bytes,
        target: Tensor | None,
        zero: int = 0,
        relu: bool = True,
    ) -> None:
        outputs, _, side, _ = weight.shape
        per = torch.ones(outputs) if target is None else 1 / target
        weight = weight * source.step[:, None, None] * per[:, None, None, None]
        step = weight.abs().amax((1, 2, 3)).clamp_min(1e-12) / 127
        whole = (weight / step[:, None, None, None]).round()
        self.bias = torch.zeros(outputs) if bias is None else bias * per
        lost = (weight - whole * step[:, None, None, None]).sum((2, 3))
        self.bias = self.bias + lost @ (source.mean / source.step)
        self.zero = int(source.zero[0]) if (source.zero == source.zero[0]).all() else 0
        self.bias = self.bias - step * (whole.sum((2, 3)) @ (source.zero - self.zero))
        self.step, self.no_zeros = step, torch.zeros(outputs, dtype=torch.int32)
        self.padding = [side // 2] * 2
        self.weight = torch.ops.onednn.qconv_prepack(
            whole.to(torch.int8), step, 1.0, self.zero, [1, 1], self.padding, [1, 1], 1, None
        )
        self.out = zero, torch.float32 if target is None else torch.uint8
        self.after = "relu" if relu and target is not None else "none"

    def __call__(self, image: Tensor) -> Tensor:
        """Map ``(1, inputs, H, W)`` to ``(1, outputs, H, W)``."""
        zero, dtype = self.out
        return torch.ops.onednn.qconv2d_pointwise(
            *self._sum(image),
            self.bias,
            [1, 1],
            self.padding,
            [1, 1],
            1,
            1.0,
            zero,
            dtype,
            self.after,
            [],
            None,
        )

    def beside(self, image: Tensor, steps: float) -> Tensor:
        """Map the image as a call does, and add it, whose steps are ``steps`` of those of the outputs."""
        added = image.clone(memory_format=torch.preserve_format)
        zero, dtype = self.out
        return torch.ops.onednn.qconv2d_pointwise.binary(
            *self._sum(image), added, self.bias, [1, 1], self.padding, [1, 1], 1, 1.0, zero, dtype,
            steps, self.zero, "sum", 1.0, self.after, [], None,
        )  # fmt: skip

    def _sum(self, image: Tensor) -> tuple[Any, ...]:
        return image, 1.0, self.zero, self.weight, self.step, self.no_zeros


class _Residual:
    """:class:`~salpcc.stages.segment.blocks.MultiKernelResidual`, its inputs ordered by column, then channel."""

    def __init__(self, block: Any, fold: int, source: _Bytes) -> None:
        inputs = block.shortcut.weight.shape[1]
        by_column = torch.arange(inputs).reshape(-1, fold).T.ravel()
        source = _Bytes(*(part.repeat(fold) for part in source))
        norm, out = block.norm[0], block.out[0]
        weight, bias = normed(centred([conv.weight[:, by_column] for conv in block.parallel]), norm)
        near = sum(len(conv.weight) for conv in block.parallel if conv.weight.shape[-1] <= 3)
        layered = _Bytes.of(_spread(norm))
        self.near = _Sums(weight[:near, :, 2:-2, 2:-2], bias[:near], source, layered.step[:near])
        self.far = _Sums(weight[near:], bias[near:], source, layered.step[near:])
        self.dense = []
        for layer in block.dense:
            grown = _Bytes.of(_spread(layer[1]))
            self.dense.append(_Sums(*normed(layer[0].weight, layer[1]), layered, grown.step))
            layered |= grown
        self.meaning = _Bytes.of(_spread(out))
        both = torch.cat([block.last.weight, block.shortcut.weight[:, by_column]], 1)
        self.last = _Sums(*normed(both, out), layered | source, self.meaning.step)

    def __call__(self, image: Tensor) -> Tensor:
        """Map ``(1, inputs, H, W)`` to ``(1, width, H, W)``."""
        layered = join([self.near(image), self.far(image)])
        for layer in self.dense:
            layered = join([layered, layer(layered)])
        return self.last(join([layered, image]))


def _filter(block: Any, source: _Bytes, target: Tensor) -> _Sums:
    """:class:`~salpcc.stages.segment.blocks.MultiKernelFilter`."""
    return _Sums(*normed(centred([block.point.weight, block.around.weight]), block.norm), source, target)


class QuantisedNetwork:
    """Labels the pixels of one whole turn as :class:`~salpcc.stages.segment.fused.FusedNetwork` does; on a CPU.

    All channels of a level have steps of their own, and all images of a level the same ones: so they add up.
    """

    def __init__(self, network: SegmentNetwork) -> None:
        self.config = network.config
        self.points = Cloud(FusedNetwork(network).points)
        blocks: Any = copy.deepcopy(network).eval().requires_grad_(False)
        largest, mean = _FEATURES
        features = _Bytes(largest / (255 - _ZERO), torch.full_like(mean, _ZERO), mean)
        parts = [_Bytes(*(one[start:end] for one in features)) for start, end in _PARTS]
        self.features = [part.step.numpy() for part in parts]
        self.modalities = [
            _Residual(block, self.config.fold, part)
            for block, part in zip(blocks.modalities, parts, strict=True)
        ]
        cloud = _Bytes.of(_spread(blocks.points.decoders[0].norm[-1]))
        self.cloud = cloud.step
        source = functools.reduce(operator.or_, [image.meaning for image in self.modalities] + [cloud])
        self.fusion = []
        for conv, norm, _ in blocks.fusion[:-1]:
            target = _Bytes.of(_spread(norm))
            self.fusion.append(_Sums(*normed(conv.weight, norm), source, target.step))
            source = target
        self._levels(blocks, source)

    def _levels(self, blocks: Any, source: _Bytes) -> None:
        conv, norm, _ = blocks.fusion[-1]
        fused = _spread(norm)
        down: list[list[_Spread]] = []  # what is expected of the filters of each level
        before = fused.rectified()
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
        chains[0].append(fused)
        steps = [torch.stack([one.step() for one in chain]).amax(0) for chain in chains]
        self.fusion.append(_Sums(*normed(conv.weight, norm), source, steps[0]))
        held = _Bytes.of(fused, steps[0])
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
            lift = _Sums(blocks.lifts[i].weight, None, held, 2 * steps[i], _ZERO, relu=False)
            zero = torch.full_like(steps[i], _ZERO)
            self.decoders.append(
                (lift, _filter(blocks.decoders[i], _Bytes(2 * steps[i], zero, joined.mean), steps[i]))
            )
            held = _Bytes.of(filtered, steps[i])
        by_column = torch.arange(N_CLASSES * self.config.fold).reshape(N_CLASSES, -1).T.ravel()
        head = blocks.head.weight[by_column], blocks.head.bias[by_column]
        self.head = _Sums(*head, held | _Bytes.of(fused, steps[0]), None)

    def logits(self, planes: F32) -> F32:
        """Return logits ``(H, W, 19)`` of planes ``(6, H, W)`` of a whole turn, which has a return."""
        fold, side = self.config.fold, SEAM // self.config.fold
        _, height, width = planes.shape
        features = pixel_features(planes, circular=True).transpose(1, 2, 0)
        images = [
            block(_image(to_bytes(features, part, step, _ZERO, SEAM).reshape(height, -1, len(step) * fold)))
            for block, part, step in zip(self.modalities, _PARTS, self.features, strict=True)
        ]
        cloud, sets = cloud_input(planes, fold, self.config.n_points)
        rows = (self.points.first_level(cloud, sets) / self.cloud).numpy()
        images.append(_image(mixed(rows, sets.pixel_parents, sets.pixel_weights, height, side)))
        level = join(images)
        for layer in self.fusion:
            level = layer(level)
        fused = level
        skips: list[Tensor] = []
        for encoder in self.encoders:
            level = _image(halved(_bytes(level))) if skips else level
            for layer, residual in encoder:
                level = layer.beside(level, 1.0) if residual else layer(level)
            skips.append(level)
        for (lift, layer), skip in zip(self.decoders, skips[-2::-1], strict=True):
            level = layer.beside(_image(lifted(_bytes(lift(level)), _bytes(skip))), 2.0)
        logits = self.head(join([level[..., side:-side], fused[..., side:-side]]))
        return logits.permute(0, 2, 3, 1).reshape(height, width, N_CLASSES).numpy()


def _image(pixels: NDArray[np.uint8]) -> Tensor:
    """Return ``(H, W, C)`` as ``(1, C, H, W)``."""
    return torch.from_numpy(pixels)[None].permute(0, 3, 1, 2)


def _bytes(image: Tensor) -> NDArray[np.uint8]:
    """Inverse of :func:`_image`."""
    return image[0].permute(1, 2, 0).numpy()


LabellingNetwork = FusedNetwork | QuantisedNetwork


def for_labelling(network: SegmentNetwork, device: str = "cpu") -> LabellingNetwork:
    """Return what a trained network labels by: whole numbers on a CPU that adds up their products, else float32."""
    # An older torch does not tell what the processor can.
    can: Mapping[str, Any] = getattr(torch.cpu, "get_capabilities", dict)() if device == "cpu" else {}
    able = any(can.get(name) for name in ("avx512_vnni", "avx_vnni", "amx_int8"))
    return QuantisedNetwork(network) if able else FusedNetwork(network, device)
