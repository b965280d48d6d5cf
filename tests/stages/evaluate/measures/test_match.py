"""Finding again which points were kept."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from salpcc.schemas.scan import Scan
from salpcc.stages.evaluate.measures.match import kept_points, match_in_order


def scan(points: np.ndarray, intensity: np.ndarray | None = None) -> Scan:
    values = np.zeros(len(points), np.float32) if intensity is None else intensity.astype(np.float32)
    return Scan("000000", points.astype(np.float32), values)


@given(st.integers(0, 2**32 - 1), st.sampled_from([0.0, 0.005, 0.02]))
def test_every_dropped_subset_is_found_within_the_bound(seed: int, bound: float) -> None:
    rng = np.random.default_rng(seed)
    source = rng.uniform(-20, 20, (60, 3)).astype(np.float32)
    kept = rng.random(60) < 0.7
    decoded = source[kept].astype(np.float64) + rng.uniform(-1, 1, (kept.sum(), 3)) * bound / 2
    found = kept_points(scan(source), scan(decoded), bound)
    assert found is not None
    error = np.linalg.norm(decoded.astype(np.float32).astype(float) - source[found], axis=1)
    assert found.sum() == kept.sum()
    assert error.max(initial=0) <= bound


def test_nothing_dropped_needs_no_search() -> None:
    source = np.zeros((4, 3))
    found = kept_points(scan(source), scan(source + 5), 0.01)
    assert found is not None and found.all()


def test_equal_points_are_told_apart_by_intensity() -> None:
    source = np.zeros((3, 3))
    found = kept_points(scan(source, np.array([1, 2, 3])), scan(source[:1], np.array([2])), 0.0)
    assert found is not None
    assert found.tolist() == [False, True, False]


def test_a_broken_promise_is_still_measured() -> None:
    source = np.array([[0, 0, 0], [10, 0, 0], [20, 0, 0]])
    found = kept_points(scan(source), scan(source[1:] + [0.1, 0, 0]), 0.01)
    assert found is not None
    assert found.tolist() == [False, True, True]


def test_an_order_that_does_not_fit_is_no_match() -> None:
    source = np.array([[0, 0, 0], [5000, 0, 0], [9000, 0, 0]])
    assert kept_points(scan(source), scan(source[[2, 0]]), 0.01) is None
    assert kept_points(scan(source[:1]), scan(source), 0.01) is None


def test_nan_points_match_themselves_only() -> None:
    source = np.array([[np.nan, 0, 0], [1, 0, 0], [np.nan, 0, 0]])
    found = kept_points(scan(source), scan(source[[0, 2]]), 0.01)
    assert found is not None
    assert found.tolist() == [True, False, True]


@pytest.mark.parametrize("bound", [0.0, 0.5, 1.5])
def test_compiled_match_agrees_with_plain_python(bound: float) -> None:
    rng = np.random.default_rng(3)
    source = np.ascontiguousarray(rng.integers(-2, 3, (40, 4)).astype(np.float32))
    decoded = np.ascontiguousarray(source[rng.random(40) < 0.5])
    kept, matched = match_in_order(
        source, decoded, source.view(np.uint32), decoded.view(np.uint32), np.float64(bound)
    )
    expected, j = [], 0
    for row in source:
        fits = j < len(decoded) and row[3] == decoded[j, 3]
        fits = fits and float(np.linalg.norm(row[:3] - decoded[j, :3])) <= bound
        expected.append(bool(fits))
        j += bool(fits)
    assert kept.tolist() == expected
    assert matched == j
