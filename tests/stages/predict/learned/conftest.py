"""A small synthetic sweep for the learned coders."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pytest

from salpcc.schemas.scan import Scan
from salpcc.stages.entropy.intervals import encode_intervals
from salpcc.stages.lattice.sensor_model import SensorModel
from salpcc.stages.lattice.sweep import scan_to_sweep
from salpcc.stages.predict.learned.network import Network
from salpcc.stages.predict.learned.range_model import HEADER, count_levels, predict_ranges


class Returns(NamedTuple):
    """Returns in firing order."""

    starts: np.ndarray
    tick: np.ndarray
    count: np.ndarray
    intensity: np.ndarray


@pytest.fixture(scope="session")
def returns(make_scan: Callable[..., Scan], sensor: SensorModel) -> Returns:
    """About 14,000 returns of ground and walls with 1 cm of noise."""
    sweep = scan_to_sweep(make_scan(seed=3, stride=8, motion=None), sensor)
    starts = np.searchsorted(sweep.laser, np.arange(sensor.n_lasers + 1)).astype(np.int64)
    intensity = np.rint(sweep.intensity * 100).astype(np.uint8)
    return Returns(starts, sweep.tick, sweep.count, intensity)


def coded(intervals: np.ndarray) -> np.ndarray:
    """The bytes of predicted intervals."""
    return np.frombuffer(encode_intervals(intervals), np.uint8)


def range_stream(
    starts: np.ndarray, tick: np.ndarray, level: np.ndarray, step: int, sensor: SensorModel, network: Network
) -> np.ndarray:
    """The bytes of range levels: how many levels there are, and the intervals."""
    header = np.frombuffer(count_levels(level).to_bytes(HEADER, "little"), np.uint8)
    return np.concatenate([header, coded(predict_ranges(starts, tick, level, step, sensor, network)[0])])
