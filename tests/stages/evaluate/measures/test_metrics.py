"""The measures, on cases small enough to work out by hand."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from salpcc.stages.evaluate.measures.metrics import (
    bits_per_point,
    compression_rate,
    point_errors,
    same_bits,
    symmetric_distance,
)

NAN, INF = np.float32(np.nan), np.float32(np.inf)


def cloud(*points: tuple[float, float, float]) -> np.ndarray:
    return np.array(points, np.float32)


def test_compression_rate_is_of_sixteen_bytes_a_point() -> None:
    assert compression_rate(40, 10) == 25.0
    assert bits_per_point(40, 10) == 32.0
    assert compression_rate(5, 0) == bits_per_point(5, 0) == 0.0


def test_errors_are_taken_in_file_order_not_to_the_nearest_point() -> None:
    source = cloud((0, 0, 0), (1, 0, 0))
    swapped = source[::-1].copy()
    assert symmetric_distance(source, swapped) == 0.0
    assert point_errors(source, swapped).maximum == 1.0


def test_error_is_three_dimensional() -> None:
    errors = point_errors(cloud((0, 0, 0), (0, 0, 0)), cloud((3, 4, 12), (0, 0, 0)))
    assert errors.maximum == 13.0
    assert errors.max_axis == 12.0
    assert errors.sum_of_squares == 169.0


@pytest.mark.parametrize("value", [NAN, INF, -INF])
def test_equal_bits_are_no_error_and_a_lost_number_is_an_infinite_one(value: np.float32) -> None:
    odd, plain = cloud((value, 0, 0)), cloud((1, 0, 0))
    assert point_errors(odd, odd.copy()).maximum == 0.0
    assert point_errors(odd, plain).maximum == np.inf
    assert point_errors(plain, odd).maximum == np.inf


def test_clouds_of_different_size_do_not_pair() -> None:
    with pytest.raises(ValueError, match="do not pair"):
        point_errors(cloud((0, 0, 0)), cloud())


def test_bits_tell_zero_from_minus_zero_and_one_nan_from_another() -> None:
    other_nan = np.array([0x7FC00001], np.uint32).view(np.float32)
    assert same_bits(np.array([NAN]), np.array([NAN]))
    assert not same_bits(np.array([NAN]), other_nan)
    assert not same_bits(np.array([0.0], np.float32), np.array([-0.0], np.float32))
    assert not same_bits(cloud((0, 0, 0)), cloud())


def test_symmetric_distance_by_hand() -> None:
    # From the source: 0 and 4 m² away; back: 0. Means 2 and 0, halves 1 and 0.
    assert symmetric_distance(cloud((0, 0, 0), (2, 0, 0)), cloud((0, 0, 0))) == pytest.approx(1.0)
    assert symmetric_distance(cloud((0, 0, 0)), cloud((0, 0, 0), (2, 0, 0))) == pytest.approx(1.0)


def test_symmetric_distance_of_nothing() -> None:
    empty = np.empty((0, 3), np.float32)
    assert symmetric_distance(empty, empty) == 0.0
    assert np.isnan(symmetric_distance(cloud((0, 0, 0)), empty))
    assert symmetric_distance(cloud((NAN, 0, 0), (1, 1, 1)), cloud((1, 1, 1))) == 0.0


@given(
    hnp.arrays(np.float32, st.tuples(st.integers(1, 30), st.just(3)), elements=st.floats(-100, 100, width=32))
)
def test_symmetric_distance_agrees_with_every_pair(points: np.ndarray) -> None:
    other = np.round(points[::-1], 0).astype(np.float32)
    pairs = np.square(points[:, None].astype(float) - other[None]).sum(axis=2)
    expected = pairs.min(axis=1).mean() / 2 + pairs.min(axis=0).mean() / 2
    assert symmetric_distance(points, other) == pytest.approx(expected, abs=1e-9)
