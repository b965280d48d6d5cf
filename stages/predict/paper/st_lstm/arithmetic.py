"""The number systems of the network: float to train, rounded to fine-tune, whole numbers to code with.

Activations are multiples of 1/128 within +-2, weights multiples of a power of two per layer, at most 255 of
them. In :class:`Exact` both are held as whole numbers in float32; no sum can reach 2**24 (checked when weights
are loaded), so every addition is exact, in any order, on any device, and even where a matrix unit rounds its
inputs to bfloat16. A convolution is a sum of matrix products: a library's own would be free to use Winograd's.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol, cast

import torch
from torch import Tensor, nn
from torch.nn import functional

from salpcc.schemas.errors import SalpccError

ONE = 128  # 1.0 of an activation
TOP = 256  # activations stay within +-2.0
LARGEST_WEIGHT = 255
_STEP = 64  # table entries to a unit, within +-8
_TABLE = torch.arange(-8 * _STEP, 8 * _STEP + 1, dtype=torch.float64) / _STEP


def sigmoid_table() -> list[float]:
    """Sigmoid of -8 to 8 in steps of 1/64, times 128, before rounding."""
    return [ONE / (1.0 + math.exp(-x)) for x in _TABLE.tolist()]


def tanh_table() -> list[float]:
    """Hyperbolic tangent of -8 to 8 in steps of 1/64, times 128, before rounding."""
    return [ONE * math.tanh(x) for x in _TABLE.tolist()]


class Arithmetic(Protocol):
    """What the network needs of numbers; tensors are ``(batch, channels, rows, columns)``."""

    def convolve(self, name: str, *parts: Tensor) -> Tensor:
        """Convolve the parts, side by side as channels, with the layer ``name``; columns are a circle."""
        ...

    def sigmoid(self, x: Tensor) -> Tensor:
        """Of a convolution's sums."""
        ...

    def tanh(self, x: Tensor) -> Tensor:
        """Of a convolution's sums."""
        ...

    def relu(self, x: Tensor) -> Tensor:
        """Of a convolution's sums, cut at 2."""
        ...

    def output(self, x: Tensor) -> Tensor:
        """Turn a convolution's sums into real numbers (floored to 1/256 where exact)."""
        ...

    def blend(self, a: Tensor, b: Tensor, c: Tensor, d: Tensor) -> Tensor:
        """``a b + c d`` of activations."""
        ...

    def product(self, a: Tensor, b: Tensor) -> Tensor:
        """``a b`` of activations."""
        ...

    def rest(self, a: Tensor) -> Tensor:
        """``1 - a``."""
        ...


def _pad(x: Tensor) -> Tensor:
    """One more cell on each side: around the circle, and zeros above and below."""
    return functional.pad(functional.pad(x, (1, 1, 0, 0), mode="circular"), (0, 0, 1, 1))


def _round(x: Tensor, steps: float) -> Tensor:
    """Round to multiples of ``1 / steps``; the gradient passes as if nothing had happened."""
    return x + (torch.floor(x * steps + 0.5) / steps - x).detach()


class Trainable(nn.Module):
    """Real numbers, or (``rounded``) the values that :class:`Exact` will have, with gradients."""

    def __init__(self, shapes: Mapping[str, tuple[int, int, int]], rounded: bool = False) -> None:
        super().__init__()
        self.rounded = rounded
        self.layers = nn.ModuleDict(
            {name: nn.Conv2d(inputs, outputs, size) for name, (outputs, inputs, size) in shapes.items()}
        )
        self.bits = dict.fromkeys(shapes, 8)
        weight, bias = self.layer("head").weight, cast(Tensor, self.layer("head").bias)
        with torch.no_grad():  # starts as the warped frame, and an error of 2**8 mm expected
            weight.mul_(0.1)
            bias.zero_()
            bias[len(bias) // 2 :] = 0.5
            bias[-1] = 2.0

    def layer(self, name: str) -> nn.Conv2d:
        """Return a layer's weights."""
        return cast(nn.Conv2d, self.layers[name])

    def settle(self) -> None:
        """Choose each layer's power of two by its largest weight, and round from now on."""
        self.rounded = True
        for name in self.layers:
            self.bits[name] = scale_bits(float(self.layer(name).weight.detach().abs().max()))

    def _activation(self, x: Tensor) -> Tensor:
        x = x.clamp(-TOP / ONE, TOP / ONE)
        return _round(x, ONE) if self.rounded else x

    def convolve(self, name: str, *parts: Tensor) -> Tensor:
        x = torch.cat(parts, 1)
        weight: Tensor = self.layer(name).weight
        bias = cast(Tensor, self.layer(name).bias)
        if self.rounded:
            scale = float(2 ** self.bits[name])
            limit = LARGEST_WEIGHT / scale
            weight = _round(weight.clamp(-limit, limit), scale)
            bias = _round(bias, scale * ONE)
        if weight.shape[-1] == 3:
            x = _pad(x)
        return functional.conv2d(x, weight, bias)

    def _index(self, x: Tensor) -> Tensor:
        return _round(x, _STEP) if self.rounded else x

    def sigmoid(self, x: Tensor) -> Tensor:
        return self._activation(torch.sigmoid(self._index(x)))

    def tanh(self, x: Tensor) -> Tensor:
        return self._activation(torch.tanh(self._index(x)))

    def relu(self, x: Tensor) -> Tensor:
        return self._activation(x.clamp(min=0.0))

    def output(self, x: Tensor) -> Tensor:
        return x

    def blend(self, a: Tensor, b: Tensor, c: Tensor, d: Tensor) -> Tensor:
        return self._activation(a * b + c * d)

    def product(self, a: Tensor, b: Tensor) -> Tensor:
        return self._activation(a * b)

    def rest(self, a: Tensor) -> Tensor:
        return 1.0 - a


def scale_bits(largest: float) -> int:
    """Return the power of two that takes a layer's largest weight to at most 255."""
    return max(0, min(14, math.floor(math.log2(LARGEST_WEIGHT / max(largest, 1e-6)))))


@dataclass(frozen=True, eq=False)
class Layer:
    """One layer in whole numbers, as float32: weight ``(outputs, inputs, n, n)``, bias ``(outputs,)``."""

    weight: Tensor
    bias: Tensor
    bits: int

    def check(self, name: str) -> None:
        """Raise SalpccError if some sum could leave the exact integers of float32."""
        whole = bool((self.weight == self.weight.round()).all() and (self.bias == self.bias.round()).all())
        reach = self.weight.abs().double().sum((1, 2, 3)) * TOP + self.bias.abs()
        if not whole or float(self.weight.abs().max()) > LARGEST_WEIGHT or float(reach.max()) >= 2.0**24:
            raise SalpccError(f"prediction network, layer {name}: weights are not exact; export them again")


class Exact:
    """Whole numbers in float32; the same on every machine."""

    def __init__(self, layers: Mapping[str, Layer], device: str = "cpu") -> None:
        for name, layer in layers.items():
            layer.check(name)
        self._layers = {
            name: Layer(layer.weight.to(device), layer.bias.to(device), layer.bits)
            for name, layer in layers.items()
        }
        self._sigmoid = torch.tensor([float(round(x)) for x in sigmoid_table()], device=device)
        self._tanh = torch.tensor([float(round(x)) for x in tanh_table()], device=device)
        self.device = device

    def convolve(self, name: str, *parts: Tensor) -> Tensor:
        layer = self._layers[name]
        outputs, inputs, size, _ = layer.weight.shape
        _, _, rows, columns = parts[0].shape
        x = torch.cat(parts, 1)[0]
        if size == 1:
            total = layer.weight[:, :, 0, 0] @ x.reshape(inputs, -1)
        else:
            padded = _pad(x[None])[0]
            total = torch.zeros((outputs, rows * columns), device=self.device)
            for i in range(3):
                for j in range(3):
                    shifted = padded[:, i : i + rows, j : j + columns].reshape(inputs, -1)
                    total.addmm_(layer.weight[:, :, i, j], shifted)
        total += layer.bias[:, None]
        # Sums are in 1 / (128 * 2**bits); a power of two scales them without rounding.
        return (total * 2.0**-layer.bits).reshape(1, outputs, rows, columns)

    def _look_up(self, table: Tensor, x: Tensor) -> Tensor:
        index = torch.floor(x * (_STEP / ONE) + 0.5).clamp(-8 * _STEP, 8 * _STEP) + 8 * _STEP
        return table[index.long()]

    def sigmoid(self, x: Tensor) -> Tensor:
        return self._look_up(self._sigmoid, x)

    def tanh(self, x: Tensor) -> Tensor:
        return self._look_up(self._tanh, x)

    def relu(self, x: Tensor) -> Tensor:
        return torch.floor(x + 0.5).clamp(0, TOP)

    def output(self, x: Tensor) -> Tensor:
        return torch.floor(x * (256 / ONE) + 0.5) / 256

    def blend(self, a: Tensor, b: Tensor, c: Tensor, d: Tensor) -> Tensor:
        return torch.floor((a * b + c * d) / ONE + 0.5).clamp(-TOP, TOP)

    def product(self, a: Tensor, b: Tensor) -> Tensor:
        return torch.floor(a * b / ONE + 0.5).clamp(-TOP, TOP)

    def rest(self, a: Tensor) -> Tensor:
        return ONE - a
