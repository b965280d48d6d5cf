"""Bits by laser add up to what the streams of ranges take, and a noisy laser stands out."""

from dataclasses import replace

import numpy as np
import pytest

from salpcc.stages.lattice.sweep import scan_to_sweep
from salpcc.stages.predict.laser_bits import laser_bits
from salpcc.stages.predict.values import predict
from salpcc.stages.residual_code.sensor.value_models import value_models


@pytest.mark.parametrize("effort", ["fast", "default"])
def test_they_are_those_of_the_stream(make_scan, sensor, effort: str) -> None:
    sweep = scan_to_sweep(make_scan(0, stride=8), sensor)
    predicted = predict(sweep, sensor, effort)
    bits = laser_bits(sweep, predicted, sensor.n_lasers)
    stream = value_models(effort, sensor).encode_levels(sweep, predicted)
    assert bits.shape == (sensor.n_lasers,) and 0 < 8 * len(stream) - bits.sum() < 0.02 * bits.sum() + 100
    gone = sweep.laser != 20
    few = {
        name: getattr(sweep, name)[gone]
        for name in ("laser", "tick", "count", "intensity", "millimetre", "ulp")
    }
    noise = np.random.default_rng(0).integers(-2000, 2000, gone.sum())
    loud = replace(sweep, **few, classes=None)
    loud = replace(
        loud,
        count=np.where(loud.laser == 40, np.maximum(loud.count + noise, 1000), loud.count).astype(np.int32),
    )
    found = laser_bits(loud, predict(loud, sensor, effort), sensor.n_lasers)
    each = found / np.maximum(np.bincount(loud.laser, minlength=sensor.n_lasers), 1)
    assert each[20] == 0 and each[40] > max(each[39], each[41]) + 1
