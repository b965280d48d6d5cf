"""Building blocks of the 2-D network: MKRB (section IV-A) and MKF (section IV-C)."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn


class Conv(nn.Sequential):
    """Convolution, batch norm, ReLU."""

    def __init__(self, inputs: int, outputs: int, kernel: int = 3) -> None:
        super().__init__(
            nn.Conv2d(inputs, outputs, kernel, padding=kernel // 2, bias=False),
            nn.BatchNorm2d(outputs),
            nn.ReLU(inplace=True),
        )


class MultiKernelResidual(nn.Module):
    """MKRB: parallel 1, 3, 5, 7 kernels, then dense layers whose last output adds to the input, eqs. (2)-(4)."""

    KERNELS: Sequence[int] = (1, 3, 5, 7)

    def __init__(self, inputs: int, width: int, growth: int, layers: int) -> None:
        super().__init__()
        share = width // len(self.KERNELS)
        self.parallel = nn.ModuleList(
            nn.Conv2d(inputs, share, kernel, padding=kernel // 2, bias=False) for kernel in self.KERNELS
        )
        self.norm = nn.Sequential(nn.BatchNorm2d(width), nn.ReLU(inplace=True))
        self.dense = nn.ModuleList(Conv(width + i * growth, growth) for i in range(layers))
        self.last = nn.Conv2d(width + layers * growth, width, 1, bias=False)
        self.shortcut = nn.Conv2d(inputs, width, 1, bias=False)
        self.out = nn.Sequential(nn.BatchNorm2d(width), nn.ReLU(inplace=True))

    def forward(self, image: Tensor) -> Tensor:
        """Map ``(B, inputs, H, W)`` to ``(B, width, H, W)``."""
        layered = self.norm(torch.cat([conv(image) for conv in self.parallel], 1))
        for layer in self.dense:
            layered = torch.cat([layered, layer(layered)], 1)
        return self.out(self.last(layered) + self.shortcut(image))


class MultiKernelFilter(nn.Module):
    """MKF: parallel 1x1 and 3x3 kernels, batch norm, ReLU; adds its input where the widths agree."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.point = nn.Conv2d(inputs, outputs // 4, 1, bias=False)
        self.around = nn.Conv2d(inputs, outputs - outputs // 4, 3, padding=1, bias=False)
        self.norm = nn.BatchNorm2d(outputs)
        self.residual = inputs == outputs

    def forward(self, features: Tensor) -> Tensor:
        """Map ``(B, inputs, H, W)`` to ``(B, outputs, H, W)``."""
        both = self.norm(torch.cat([self.point(features), self.around(features)], 1))
        return torch.relu(both + features) if self.residual else torch.relu(both)
