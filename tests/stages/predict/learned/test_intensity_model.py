"""The learned intensity coder: exact inverse, safe on damaged data."""

import numpy as np
import pytest

from salpcc.stages.lattice.sensor_model import SensorModel
from salpcc.stages.predict.learned.intensity_model import decode_intensity, predict_intensity
from salpcc.stages.predict.learned.shipped import EFFORTS, load_models

from .conftest import Returns, coded


def encode(returns: Returns, step: int, sensor: SensorModel, effort: str = "default") -> np.ndarray:
    level = returns.count // step
    network = load_models(effort).intensity
    intervals = predict_intensity(
        returns.starts, returns.tick, level, step, returns.intensity, sensor, network
    )
    return coded(intervals)


@pytest.mark.parametrize("effort", EFFORTS)
@pytest.mark.parametrize("step", [1, 10])
def test_intensities_come_back(returns: Returns, sensor: SensorModel, effort: str, step: int) -> None:
    data = encode(returns, step, sensor, effort)
    value, sound = decode_intensity(
        returns.starts, returns.tick, returns.count // step, step, sensor, load_models(effort).intensity, data
    )
    assert sound
    np.testing.assert_array_equal(value, returns.intensity)


def test_any_intensities_come_back(returns: Returns, sensor: SensorModel) -> None:
    rng = np.random.default_rng(1)
    wild = returns._replace(intensity=rng.integers(0, 101, len(returns.tick)).astype(np.uint8))
    data = encode(wild, 1, sensor)
    network = load_models("default").intensity
    value, sound = decode_intensity(wild.starts, wild.tick, wild.count, 1, sensor, network, data)
    assert sound
    np.testing.assert_array_equal(value, wild.intensity)


def test_an_intensity_above_100_is_refused(returns: Returns, sensor: SensorModel) -> None:
    with pytest.raises(ValueError, match="must lie in 0"):
        encode(returns._replace(intensity=returns.intensity + np.uint8(101)), 1, sensor)


def test_damage_never_leaves_the_bounds(returns: Returns, sensor: SensorModel) -> None:
    network = load_models("default").intensity
    good = encode(returns, 5, sensor)
    rng = np.random.default_rng(7)
    for _ in range(6):
        bad = good.copy()
        bad[rng.integers(0, len(bad), 4)] ^= rng.integers(1, 256, 4).astype(np.uint8)
        bad = bad[: rng.integers(1, len(bad))]
        value, _ = decode_intensity(returns.starts, returns.tick, returns.count // 5, 5, sensor, network, bad)
        assert value.max() <= 100
