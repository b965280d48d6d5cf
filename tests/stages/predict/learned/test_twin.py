"""The kernels' Python source, run by NumPy without a compiler, is the oracle of what is compiled from it."""

import os
import subprocess
import sys

# Predict a few rings of a wavy wall with gaps and noise, alone and with the sweep before; print what came out.
_SCRIPT = """
from dataclasses import replace
from hashlib import sha256
import numpy as np
from salpcc.schemas.sweep import Sweep
from salpcc.stages.lattice.sensor_model import load_sensor
from salpcc.stages.predict.learned.intensity_model import predict_intensity
from salpcc.stages.predict.learned.shipped import load_models
from salpcc.stages.predict.learned.previous_sweep import warp
from salpcc.stages.predict.learned.range_model import predict_ranges
from salpcc.stages.predict.ring_starts import ring_starts
sensor = load_sensor("hdl64e")
rng = np.random.default_rng(11)
laser = np.repeat([3, 4, 5, 6, 9, 40, 41], [30, 28, 0, 25, 3, 1, 20]).astype(np.uint8)
tick = np.concatenate([np.sort(rng.choice(120, n, replace=False)) for n in np.bincount(laser)]).astype(np.int32)
count = (6000 + 300 * np.sin(tick / 20) + rng.normal(0, 4, len(tick))).astype(np.int32)
count[::17] += 4000
value = rng.integers(0, 101, len(tick)).astype(np.uint8)
none = np.zeros(0, np.uint8)
sweep = Sweep(
    "", 0, "", len(tick), np.full(6, 1e-3), 1, 0.0, laser, tick, count, (value / np.float32(100)).astype(np.float32),
    np.full(len(tick), 13, np.uint8), np.full(len(tick), 13, np.uint8), None,
    np.zeros(0, np.int64), np.zeros((0, 4), np.float32), None,
)
starts = ring_starts(laser, sensor.n_lasers)
for effort, before in (("default", None), ("max", None), ("max", sweep)):
    models = load_models(effort)
    seen = warp(before, sweep.motion, sensor) if effort == "max" else None
    for step in (1, 10):
        level = count // step
        ranges, order = predict_ranges(starts, tick, level, step, sensor, models.ranges, seen)
        values = predict_intensity(starts, tick, level, step, value, sensor, models.intensity, seen)
        assert (ranges[:, 1] > 0).all() and (values[:, 1] > 0).all()
        print(effort, step, sha256(order.tobytes() + ranges.tobytes()).hexdigest(), sha256(values.tobytes()).hexdigest())
"""


def run(**settings: str) -> list[str]:
    done = subprocess.run(
        [sys.executable, "-c", _SCRIPT],
        env=os.environ | settings,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


def test_compiled_kernels_equal_their_python_source() -> None:
    plain = run(NUMBA_DISABLE_JIT="1")
    assert len(plain) == 6 and plain == run()
