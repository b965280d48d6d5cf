"""Kernels of byte images against plain NumPy."""

import numpy as np

from salpcc.stages.segment.byte_images import halved, lifted


def _bytes(*shape: int) -> np.ndarray:
    return np.random.default_rng(sum(shape)).integers(0, 256, shape).astype(np.uint8)


def test_halved_and_lifted() -> None:
    image = _bytes(8, 12, 20)
    assert (halved(image) == image.reshape(4, 2, 6, 2, 20).max((1, 3))).all()
    low = _bytes(4, 6, 20)
    plain = low.repeat(2, 0).repeat(2, 1) + np.rint(image / 2)
    assert (lifted(low, image) == np.minimum(plain, 255)).all()
