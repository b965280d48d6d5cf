"""The same intervals whatever the processor can do: numba for a plain CPU against this machine's own."""

import os
import subprocess
import sys
from hashlib import sha256
from pathlib import Path

import numpy as np

from salpcc.stages.ingest.sensor_model import SensorModel
from salpcc.stages.predict.learned.intensity_model import predict_intensity
from salpcc.stages.predict.learned.models import load_models
from salpcc.stages.predict.learned.range_model import predict_ranges

from .conftest import Returns

_SCRIPT = """
import sys
from hashlib import sha256
import numpy as np
from salpcc.stages.ingest.sensor_model import load_sensor
from salpcc.stages.predict.learned.intensity_model import predict_intensity
from salpcc.stages.predict.learned.models import load_models
from salpcc.stages.predict.learned.range_model import predict_ranges
r = np.load(sys.argv[1])
starts, tick, level, value = r["starts"], r["tick"], r["level"], r["value"]
sensor, models = load_sensor("hdl64e"), load_models("default")
for intervals in (
    predict_ranges(starts, tick, level, 5, sensor, models.ranges),
    predict_intensity(starts, tick, level, 5, value, sensor, models.intensity),
):
    print(sha256(intervals.tobytes()).hexdigest())
"""


def test_a_plain_processor_predicts_the_same(returns: Returns, sensor: SensorModel, tmp_path: Path) -> None:
    part = slice(0, int(returns.starts[24]))  # 24 rings keep the test short
    starts = np.minimum(returns.starts, part.stop)
    tick, level, value = returns.tick[part], returns.count[part] // 5, returns.intensity[part]
    np.savez(tmp_path / "returns.npz", starts=starts, tick=tick, level=level, value=value)
    environment = os.environ | {
        "NUMBA_CPU_NAME": "generic",
        "NUMBA_CPU_FEATURES": "",
        "NUMBA_CACHE_DIR": str(tmp_path / "cache"),
    }
    command = [sys.executable, "-c", _SCRIPT, str(tmp_path / "returns.npz")]
    printed = subprocess.run(
        command, env=environment, capture_output=True, text=True, check=True
    ).stdout.split()

    models = load_models("default")
    expected = [
        sha256(intervals.tobytes()).hexdigest()
        for intervals in (
            predict_ranges(starts, tick, level, 5, sensor, models.ranges),
            predict_intensity(starts, tick, level, 5, value, sensor, models.intensity),
        )
    ]
    assert printed == expected
