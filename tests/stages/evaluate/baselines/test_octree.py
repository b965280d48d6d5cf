"""The parts of the octree baseline."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from salpcc.stages.evaluate.baselines.octree import decode, encode, interleave, separate
from salpcc.stages.evaluate.baselines.static_range_coder import decode_bytes, encode_bytes

CELLS = hnp.arrays(np.uint64, st.tuples(st.integers(1, 50), st.just(3)), elements=st.integers(0, 2**21 - 1))


@given(CELLS)
def test_morton_codes_interleave_every_bit(cells: np.ndarray) -> None:
    codes = interleave(cells)
    bits = [
        sum(((int(v) >> b) & 1) << (3 * b + 2 - axis) for axis, v in enumerate(c) for b in range(21))
        for c in cells
    ]
    assert codes.tolist() == bits
    assert np.array_equal(separate(codes), cells)


@given(st.binary(max_size=2000))
def test_range_coder_round_trip(data: bytes) -> None:
    symbols = np.frombuffer(data, np.uint8)
    assert decode_bytes(encode_bytes(symbols)).tobytes() == data


def test_range_coder_comes_near_the_entropy() -> None:
    symbols = np.random.default_rng(1).geometric(0.3, 50_000).clip(0, 255).astype(np.uint8)
    share = np.bincount(symbols)[1:] / len(symbols)
    entropy = -(share[share > 0] * np.log2(share[share > 0])).sum() * len(symbols) / 8
    assert len(encode_bytes(symbols)) < 1.005 * entropy + 300


def test_points_in_one_voxel_become_one() -> None:
    points = np.array([[1.0, 1.0, 1.0], [1.004, 1.0, 1.0], [-7.0, 2.0, 0.0]], np.float32)
    decoded = decode(encode(points, 0.01))
    assert np.allclose(decoded[np.argsort(decoded[:, 0])], [[-7, 2, 0], [1, 1, 1]], atol=1e-6)


def test_one_point_and_none() -> None:
    assert decode(encode(np.array([[5, 6, 7]], np.float32), 0.5)).tolist() == [[5, 6, 7]]
    assert decode(encode(np.empty((0, 3), np.float32), 0.5)).shape == (0, 3)
