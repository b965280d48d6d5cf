"""Clouds of any sensor are brought to the height and the brightness that the network knows; its own stay as they are."""

import numpy as np
import pytest

from salpcc.stages.segment.network.view import AS_IT_IS, view_of


def _street(ground: float) -> np.ndarray:
    rng = np.random.default_rng(0)
    floor = np.column_stack([rng.uniform(-30, 30, (20000, 2)), rng.normal(ground, 0.02, 20000)])
    walls = np.column_stack(
        [rng.uniform(-30, 30, 4000), rng.choice([-9.0, 9.0], 4000), rng.uniform(ground, 5, 4000)]
    )
    return np.concatenate([floor, walls]).astype(np.float32)


def _fractions(cloud: np.ndarray) -> np.ndarray:
    return np.random.default_rng(1).uniform(0, 1, len(cloud)).astype(np.float32)


def test_the_networks_own_sensor_sees_what_it_saw() -> None:
    cloud = _street(-1.8)
    assert view_of([(cloud, _fractions(cloud))]) == AS_IT_IS


@pytest.mark.parametrize("ground", [-3.2, -0.4, 0.0])
def test_the_ground_is_where_the_network_knows_it(ground: float) -> None:
    cloud = _street(ground)
    view = view_of([(cloud, _fractions(cloud))] * 3)
    assert ground + view.lift == pytest.approx(-1.75, abs=0.1)


def test_one_scan_without_ground_does_not_lift_the_group() -> None:
    high = _street(-1.75)
    few = np.float32([[3, 0, 1]])
    assert view_of([(high, _fractions(high)), (few, np.float32([0.5])), (high, _fractions(high))]).lift == 0


@pytest.mark.parametrize("unit", [255.0, 7000.0])
def test_counts_of_any_unit_become_fractions(unit: float) -> None:
    cloud = _street(-1.75)
    intensity = _fractions(cloud)
    view = view_of([(cloud, intensity * np.float32(unit))])
    assert np.median(intensity * unit * view.brightness) == pytest.approx(0.28, abs=1e-3)


@pytest.mark.parametrize("constant", [0.0, 1.0, 100.0, np.nan])
def test_intensities_that_tell_nothing_are_none(constant: float) -> None:
    cloud = _street(-1.75)
    assert view_of([(cloud, np.full(len(cloud), constant, np.float32))]).brightness == 0


def test_no_returns_at_all() -> None:
    nothing = np.full((5, 3), np.nan, np.float32)
    assert view_of([(nothing, np.zeros(5, np.float32))]).lift == 0
    assert view_of([]).lift == 0
