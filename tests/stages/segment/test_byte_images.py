"""Kernels of byte images against plain NumPy."""

import numpy as np

from salpcc.stages.segment.byte_images import halved, lifted, mixed, to_bytes


def _bytes(*shape: int) -> np.ndarray:
    return np.random.default_rng(sum(shape)).integers(0, 256, shape).astype(np.uint8)


def test_features_become_bytes_and_go_round() -> None:
    features = np.random.default_rng(0).normal(0, 2, (4, 16, 5)).astype(np.float32)
    step = np.float32([0.01, 0.02, 0.05])
    found = to_bytes(features, (2, 5), step, 128, 4)
    assert found.shape == (4, 24, 3)
    plain = np.clip(np.floor(features[..., 2:] / step + 128.5), 0, 255)
    assert np.abs(found[:, 4:-4] - plain).max() <= 1 and (found[:, 4:-4] == plain).mean() > 0.99
    assert (found[:, :4] == found[:, 16:20]).all() and (found[:, -4:] == found[:, 4:8]).all()


def test_points_are_mixed() -> None:
    rng = np.random.default_rng(1)
    rows = rng.uniform(0, 200, (9, 5)).astype(np.float32)
    parents, weights = rng.integers(0, 9, (4 * 8, 3)), rng.dirichlet([1, 1, 1], 4 * 8).astype(np.float32)
    weights[3] = 0  # nobody asked
    plain = (rows[parents] * weights[..., None]).sum(1).reshape(4, 8, 5)
    found = mixed(rows, parents, weights, 4, 2)
    assert np.abs(found[:, 2:-2] - plain).max() <= 0.51 and not found[0, 2 + 3].any()
    assert (found[:, :2] == found[:, 8:10]).all() and (found[:, -2:] == found[:, 2:4]).all()
    assert mixed(rows * 9, parents, weights, 4, 2).max() == 255


def test_halved_and_lifted() -> None:
    image = _bytes(8, 12, 20)
    assert (halved(image) == image.reshape(4, 2, 6, 2, 20).max((1, 3))).all()
    low = _bytes(4, 6, 20)
    plain = low.repeat(2, 0).repeat(2, 1) + np.rint(image / 2)
    assert (lifted(low, image) == np.minimum(plain, 255)).all()
