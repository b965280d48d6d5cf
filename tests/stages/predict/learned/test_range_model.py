"""The learned range coder: exact inverse, worth its bits, safe on damaged data."""

import numpy as np
import pytest

from salpcc.stages.lattice.sensor_model import SensorModel
from salpcc.stages.predict.learned.range_model import LEVEL_LIMIT, decode_ranges, predict_ranges
from salpcc.stages.predict.learned.shipped import EFFORTS, load_models

from .conftest import Returns, range_stream


def encode(returns: Returns, step: int, sensor: SensorModel, effort: str = "default") -> np.ndarray:
    level = returns.count // step
    return range_stream(returns.starts, returns.tick, level, step, sensor, load_models(effort).ranges)


@pytest.mark.parametrize("effort", EFFORTS)
@pytest.mark.parametrize("step", [1, 5, 20, 333])
def test_levels_come_back(returns: Returns, sensor: SensorModel, effort: str, step: int) -> None:
    data = encode(returns, step, sensor, effort)
    level, sound = decode_ranges(returns.starts, returns.tick, step, sensor, load_models(effort).ranges, data)
    assert sound
    np.testing.assert_array_equal(level, returns.count // step)


def test_any_levels_come_back(returns: Returns, sensor: SensorModel) -> None:
    rng = np.random.default_rng(1)
    wild = returns._replace(count=rng.integers(0, LEVEL_LIMIT, len(returns.tick)).astype(np.int32))
    data = encode(wild, 1, sensor)
    level, sound = decode_ranges(wild.starts, wild.tick, 1, sensor, load_models("default").ranges, data)
    assert sound
    np.testing.assert_array_equal(level, wild.count)


def test_surfaces_cost_little(returns: Returns, sensor: SensorModel) -> None:
    """1 cm of noise costs 4.4 bits at 2 mm; every eighth firing of a wavy wall may add some, not eleven."""
    assert 8 * len(encode(returns, 1, sensor)) / len(returns.tick) < 9.0


def test_empty_sweep_and_empty_rings(sensor: SensorModel) -> None:
    network = load_models("default").ranges
    starts = np.zeros(65, np.int64)
    starts[40:] = 1
    for s, count in ((np.zeros(65, np.int64), []), (starts, [5000])):
        tick = np.full(len(count), 7, np.int32)
        level = np.array(count, np.int32)
        data = range_stream(s, tick, level, 1, sensor, network)
        back, sound = decode_ranges(s, tick, 1, sensor, network, data)
        assert sound
        np.testing.assert_array_equal(back, level)


def test_a_bad_level_is_refused(returns: Returns, sensor: SensorModel) -> None:
    network = load_models("default").ranges
    with pytest.raises(ValueError, match="range levels"):
        predict_ranges(returns.starts, returns.tick, returns.count - 10**6, 1, sensor, network)


def test_damage_never_leaves_the_bounds(returns: Returns, sensor: SensorModel) -> None:
    network = load_models("default").ranges
    good = encode(returns, 5, sensor)
    rng = np.random.default_rng(7)
    for trial in range(12):
        bad = good.copy()
        bad[rng.integers(0 if trial % 2 else 3, len(bad), 4)] ^= rng.integers(1, 256, 4).astype(np.uint8)
        if trial % 3 == 0:
            bad = bad[: rng.integers(0, len(bad))]
        level, _ = decode_ranges(returns.starts, returns.tick, 5, sensor, network, bad)
        assert level.min() >= 0
        assert level.max() < LEVEL_LIMIT
