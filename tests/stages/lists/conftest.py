"""A sensor whose model is known, and what it sees."""

import numpy as np
import pytest
from numpy.typing import NDArray

from salpcc.stages.lattice.lattice import unproject
from salpcc.stages.lattice.sensor_model import SensorModel

LASERS, COLUMNS = 32, 512
Points = NDArray[np.float32]


@pytest.fixture(scope="session")
def fan() -> SensorModel:
    """Levers, beams that are turned against each other, 1 mm counts: much like an OS-1."""
    rng = np.random.default_rng(0)
    return SensorModel(
        "fan", 1024, 0.001, np.radians(np.linspace(16, -16, LASERS)), np.full(LASERS, 0.036), rng.normal(0, 0.001, LASERS),
        rng.uniform(-3e-3, 3e-3, LASERS), np.full(LASERS, -2e-4), np.zeros(LASERS, np.int64),
    )  # fmt: skip


@pytest.fixture(scope="session")
def rows(fan: SensorModel) -> Points:
    """Ground and walls, ``(LASERS, COLUMNS, 3)``, float32 as computed; zeros where nothing came back."""
    rng = np.random.default_rng(1)
    laser = np.repeat(np.arange(LASERS), COLUMNS)
    tick = np.tile(np.arange(COLUMNS) * 2, LASERS)
    wall = 12.0 + 5.0 * np.sin(tick / 1024 * 6 * np.pi) + tick // 100 % 2 * 3.0
    ground = 1.7 / np.maximum(-np.sin(fan.theta[laser]), 0.02)
    count = np.rint((np.minimum(wall, ground) + rng.normal(0, 0.01, len(tick))) / fan.count)
    points = unproject(fan, laser.astype(np.uint8), tick.astype(np.int32), count).astype(np.float32)
    points[rng.random(len(points)) < 0.05] = 0
    return points.reshape(LASERS, COLUMNS, 3)
