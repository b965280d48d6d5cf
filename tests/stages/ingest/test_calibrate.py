"""A sensor model is found from nothing but raw scans."""

from dataclasses import replace

import numpy as np
import pytest

from salpcc.schemas.errors import SensorError
from salpcc.stages.ingest.calibrate import fit_sensor, share_exact
from salpcc.stages.ingest.lattice import unproject
from salpcc.stages.ingest.order import azimuth_keys


@pytest.fixture(scope="module")
def small_sensor(sensor):
    pick = [0, 20, 40, 60]
    arrays = {k: getattr(sensor, k)[pick] for k in ("theta", "z0", "h", "phi0", "d0", "shift")}
    return replace(sensor, name="small", **arrays)


@pytest.fixture(scope="module")
def raw_scans(small_sensor):
    rng = np.random.default_rng(0)
    scans = []
    for _ in range(6):
        firings = np.cumsum(rng.choice([1, 2], 2600, p=[0.15, 0.85]))
        firings = firings[firings < small_sensor.ticks_per_turn]
        laser = np.repeat(np.arange(4), len(firings))
        tick = (np.tile(firings, 4) + small_sensor.shift[laser]) % small_sensor.ticks_per_turn
        count = rng.integers(1500, 30_000, len(laser))
        model = unproject(small_sensor, laser.astype(np.uint8), tick.astype(np.int32), count.astype(np.int32))
        order = np.lexsort((azimuth_keys(model), laser))
        scans.append(np.rint(model[order] * 1000).astype(np.int64))
    return scans


def test_fit_finds_the_sensor(small_sensor, raw_scans) -> None:
    found = fit_sensor(raw_scans, replace(small_sensor, theta=np.zeros(4)), "found")
    assert share_exact(small_sensor, raw_scans) == 1.0
    assert share_exact(found, raw_scans) > 0.99
    assert np.abs(found.theta - small_sensor.theta).max() < 1e-6
    assert np.abs(found.h - small_sensor.h).max() < 1e-5
    relative = (found.shift - small_sensor.shift) % small_sensor.ticks_per_turn
    assert len(set(relative.tolist())) == 1


def test_too_little_to_calibrate_on(small_sensor, raw_scans) -> None:
    with pytest.raises(SensorError, match="no scan"):
        fit_sensor([], small_sensor, "x")
    with pytest.raises(SensorError, match="more scans"):
        fit_sensor([raw_scans[0][::20]], small_sensor, "x")
