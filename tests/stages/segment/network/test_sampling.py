"""The 3-D branch's index sets against plain NumPy."""

import numpy as np

from salpcc.stages.segment.network.sampling import GROUP, farthest_points, interpolate, sample


def _cloud(count: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).normal(0, 10, (count, 3)).astype(np.float32)


def _farthest_by_definition(points: np.ndarray, count: int) -> list[int]:
    chosen = [0]
    while len(chosen) < count:
        steps = points[:, None] - points[chosen]
        distance = (steps[..., 0] ** 2 + steps[..., 1] ** 2 + steps[..., 2] ** 2).min(1)
        chosen.append(int(distance.argmax()))
    return chosen


def test_farthest_points_against_the_definition() -> None:
    points = _cloud(300)
    assert farthest_points(points, 40).tolist() == _farthest_by_definition(points, 40)
    # Twins and a lattice: ties, which the lower place wins; and all points of some buckets taken.
    twins = np.concatenate([points, points[::-1]])
    assert farthest_points(twins, 300).tolist() == _farthest_by_definition(twins, 300)
    lattice = np.stack(np.meshgrid(*[np.arange(8)] * 3), -1).reshape(-1, 3).astype(np.float32)
    assert farthest_points(lattice, 512).tolist() == _farthest_by_definition(lattice, 512)


def test_farthest_points_are_nested_and_forget_where_they_are() -> None:
    points = _cloud(500, 1)
    assert (farthest_points(points, 64)[:16] == farthest_points(points, 16)).all()
    turned = points[:, [1, 0, 2]] * np.float32([-1, 1, 1])
    assert (farthest_points(turned, 64) == farthest_points(points, 64)).all()


def test_interpolation_against_brute_force() -> None:
    points, queries = _cloud(50), _cloud(20, 2)
    nearest, weights = interpolate(points, queries)
    distance = np.linalg.norm(points[None] - queries[:, None], axis=2)
    assert (np.sort(nearest, 1) == np.sort(distance.argsort(1)[:, :3], 1)).all()
    inverse = 1 / (np.take_along_axis(distance, nearest, 1) + 0.05)
    assert np.allclose(weights, inverse / inverse.sum(1, keepdims=True), atol=1e-5)
    own, sure = interpolate(points, points)
    assert (own[:, 0] == np.arange(50)).all() and (sure[:, 0] > 0.6).all()


def test_sets_of_an_image() -> None:
    points, queries = _cloud(3000), _cloud(100, 3)
    sets = sample(points, queries, 64)
    source = points[sets.source]
    assert [len(c) for c in sets.centres] == [64, 16, 4]
    first = source[sets.centres[0]]
    for centre, group in zip(sets.centres[0], sets.groups[0], strict=True):
        distance = np.linalg.norm(source - source[centre], axis=1)
        assert set(group) == set(np.argsort(distance, kind="stable")[:GROUP])
    assert sets.groups[1].max() < 64 and sets.groups[2].max() < 16
    assert sets.parents[0].shape == (64, 3) and sets.parents[1].shape == (16, 3)
    assert (
        np.linalg.norm(first[sets.pixel_parents[:, 0]] - queries, axis=1)
        <= np.linalg.norm(first[None] - queries[:, None], axis=2).min(1) + 1e-5
    ).all()


def test_few_points_are_enough() -> None:
    sets = sample(_cloud(1), _cloud(3), 64, np.random.default_rng(0))
    assert sets.source.max() == 0 and np.isfinite(sets.pixel_weights).all()


def test_queries_that_nobody_asks_weigh_nothing() -> None:
    points, queries = _cloud(3000), _cloud(100, 3)
    asked = np.arange(100) % 3 > 0
    some, every = sample(points, queries, 64, asked=asked), sample(points, queries, 64)
    assert not some.pixel_weights[~asked].any()
    assert (some.pixel_weights[asked] == every.pixel_weights[asked]).all()
    assert (some.pixel_parents[asked] == every.pixel_parents[asked]).all()
