"""Synthetic scans on the shipped sensor's lattice: small, seeded, and as KITTI would have written them."""

from collections.abc import Callable

import numpy as np
import pytest

from salpcc.schemas.scan import Scan
from salpcc.stages.lattice.lattice import unproject
from salpcc.stages.lattice.order import azimuth_keys
from salpcc.stages.lattice.sensor_model import SensorModel, load_sensor
from salpcc.stages.lattice.untwist import twist

DRIVING = np.array([-1.2, 0.02, -0.01, 5e-4, 1e-3, -8e-3])


@pytest.fixture(scope="session")
def sensor() -> SensorModel:
    return load_sensor("hdl64e")


@pytest.fixture(scope="session")
def make_scan(sensor: SensorModel) -> Callable[..., Scan]:
    """Return a maker of scans: ground and walls with noise, every ``stride``-th firing, ``motion`` or raw."""

    def make(
        seed: int = 0, stride: int = 4, motion: np.ndarray | None = DRIVING, name: str = "000000"
    ) -> Scan:
        rng = np.random.default_rng(seed)
        firings = np.arange(0, sensor.ticks_per_turn, 2 * stride)
        laser = np.repeat(np.arange(sensor.n_lasers), len(firings))
        tick = (np.tile(firings, sensor.n_lasers) + sensor.shift[laser]) % sensor.ticks_per_turn
        wall = 12.0 + 6.0 * np.sin(tick / 4000 * 2 * np.pi * 3 + seed) + (tick // 300 % 2) * 3.0
        ground = 1.73 / np.maximum(-np.sin(sensor.theta[laser]), 0.02)
        distance = np.minimum(wall, ground) + rng.normal(0, 0.01, len(tick))
        count = np.rint((distance - sensor.d0[laser]) / sensor.count)
        seen = rng.random(len(tick)) < 0.9
        laser, tick, count = laser[seen], tick[seen], count[seen]
        model = unproject(sensor, laser.astype(np.uint8), tick.astype(np.int32), count)
        order = np.lexsort((azimuth_keys(model), laser))
        raw = (np.rint(model[order] * 1000) / 1000).astype(np.float32)
        points = raw if motion is None else twist(raw.astype(np.float64), motion).astype(np.float32)
        material = (20 + 10 * np.sin(laser[order] / 5) + rng.integers(0, 8, len(order))).astype(int)
        classes = np.where(ground[seen][order] < wall[seen][order], 9, 13).astype(np.uint8)
        classes[rng.random(len(order)) < 0.02] = 1
        return Scan(name, points, (material / 100).astype(np.float32), 123, "velodyne", classes)

    return make


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with what needs few kernels: meanwhile the tests beside these (Makefile) compile those of the codec, for both."""
    items.sort(key=lambda item: "segment" not in item.path.parts)
