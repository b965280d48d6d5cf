"""Kernels of byte images against plain NumPy."""

import numpy as np
import pytest
import torch

from salpcc.stages.segment.network.bfloat16 import as_numbers
from salpcc.stages.segment.network.byte_images import halved, lifted, rounded


def _bytes(*shape: int) -> np.ndarray:
    return np.random.default_rng(sum(shape)).integers(0, 256, shape).astype(np.uint8)


@pytest.mark.parametrize("dtype", [torch.float32, torch.bfloat16])
def test_rounded(dtype: torch.dtype) -> None:
    image = torch.from_numpy(_bytes(4, 6, 20)).to(dtype) * 1.5 + 0.25
    wanted = image.float().round().clamp_max(255).numpy()
    assert (rounded(as_numbers(image)) == wanted).all() and wanted.max() == 255


def test_halved_and_lifted() -> None:
    image = _bytes(8, 12, 20)
    assert (halved(image) == image.reshape(4, 2, 6, 2, 20).max((1, 3))).all()
    low = _bytes(4, 6, 20)
    plain = low.repeat(2, 0).repeat(2, 1) + np.rint(image / 2)
    assert (lifted(low, image) == np.minimum(plain, 255)).all()
