"""Points that were float16, and lasers that the sensor tells: exact, smaller than a general coder's planes of bytes."""

import lzma

import numpy as np
import pytest

from salpcc.stages.lists.list_coder import decode_list, encode_list
from salpcc.stages.lists.list_plan import plan
from salpcc.stages.lists.rays.ray_forms import HALVES

LASERS, FIRINGS = 32, 500


@pytest.fixture(scope="module")
def stacked() -> tuple[np.ndarray, np.ndarray]:
    """Two sensors in one list, one point of each in turn, as float16; and their rings."""
    rng = np.random.default_rng(0)
    laser, firing = np.tile(np.arange(LASERS), FIRINGS), np.repeat(np.arange(FIRINGS), LASERS)
    theta, phi = np.radians(np.linspace(-24, 12, LASERS))[laser], 2 * np.pi * firing / FIRINGS
    far = np.minimum(14 + 5 * np.sin(3 * phi), 1.9 / np.maximum(-np.sin(theta), 0.02)) + rng.normal(
        0, 0.01, len(phi)
    )
    one = far[:, None] * np.stack(
        [np.cos(theta) * np.cos(phi), np.cos(theta) * np.sin(phi), np.sin(theta)], axis=1
    )
    other = one[::-1] * (1, -1, 0.9) + (0, 0, 0.4)
    both = np.stack([one, other], axis=1).reshape(-1, 3) + (1.3, 0, 1.6)
    rings = np.stack([laser, LASERS + laser[::-1]], axis=1).ravel()
    seen = rng.random(len(both)) < 0.7
    return both[seen].astype(np.float16).astype(np.float32), rings[seen].astype(np.uint8)


def coded(points: np.ndarray, rings: np.ndarray | None) -> bytes:
    data = encode_list(np.arange(len(points)), plan(points, 0.0, lanes=rings))
    _, back, _, sound = decode_list(len(points), 0.0, np.frombuffer(bytearray(data), np.uint8))
    assert sound
    assert back.tobytes() == points.tobytes()
    return data


def test_smaller_than_planes_of_bytes(stacked) -> None:
    points, rings = stacked
    data = coded(points, rings)
    assert data[4] == HALVES
    planes = lzma.compress(points.view(np.uint8).reshape(-1, 12).T.tobytes(), preset=9)
    assert len(data) < 0.75 * len(planes)
    assert len(data) < 0.8 * len(coded(points, None))


def test_a_wrong_ring_costs_bits_and_nothing_else(stacked) -> None:
    points, rings = stacked
    coded(points, np.random.default_rng(0).permutation(rings))


def test_what_is_no_float16_comes_back_too(stacked) -> None:
    points, rings = stacked
    odd = points.copy()
    odd[::17] += np.float32(1e-4)
    odd[5:900:50] = np.nan
    odd[7:900:50] = 0.0
    odd[9:900:50] = -0.0
    odd[11:900:50, 1] = 65504.0
    odd[13:900:50] = np.float32(6e-8)
    coded(odd, rings)
    coded(-odd, None)
