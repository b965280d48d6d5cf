"""Lasers of clouds that are coded in the order of their list: counted by the rings that their message tells, or unknown."""

import numpy as np
import pytest

from salpcc.pipeline.find.catalogue import catalogue_of
from salpcc.schemas.config import RunConfig
from salpcc.schemas.labels import CLASSES
from salpcc.schemas.scan import Scan
from salpcc.stages.coding import code
from salpcc.stages.evaluate.report.schema import METRICS
from salpcc.stages.ingest.arrays import scan_from_arrays
from salpcc.stages.lattice.lattice import driven
from salpcc.stages.lattice.sensor_model import load_sensor

SICK = 5
CAR, ROAD = (next(i for i, c in enumerate(CLASSES) if c.name == name) for name in ("car", "road"))


def _cloud(rings: bool, layered: bool) -> Scan:
    """A turn of a VLP-16 in a room, laser 5 dead: its places in the list are zeros."""
    sensor = load_sensor("vlp16")
    laser = np.tile(np.arange(16, dtype=np.uint8), 200)
    tick = np.repeat(np.arange(200, dtype=np.int32) * (sensor.ticks_per_turn // 200), 16)
    count = np.rint((6.0 + np.sin(tick / 3000)) / sensor.count)
    points = driven(sensor, laser, tick, count).astype(np.float32)
    points[laser == SICK] = 0
    classes = np.where(laser % 3 == 0, CAR, ROAD).astype(np.uint8) if layered else None
    fields = {"ring": laser.astype(np.uint16)} if rings else {}
    return scan_from_arrays(points, classes=classes, **fields)


@pytest.mark.parametrize(
    ("sensor", "rings", "silent"), [("vlp16", True, 1), ("vlp16", False, None), ("xt32", True, None)]
)
@pytest.mark.parametrize("layers", [1, 2])
def test_lasers_are_counted_where_they_are_known(
    sensor: str, rings: bool, silent: int | None, layers: int
) -> None:
    scan = _cloud(rings, layers == 2)
    config = {"sensor": sensor, "effort": "fast", "keep_movable": layers == 1}
    config |= {"labels": "given"} if layers == 2 else {}
    payload = code([(0, scan)], RunConfig.model_validate(config))["residual_code"]
    assert payload.column("movable")[0].is_valid == (layers == 2)
    row = {"sequence": "log", "points_in": len(scan.points)} | payload.select(
        ["name", "time", "laser_returns", "laser_bits"]
    ).to_pylist()[0]
    if silent is not None:
        assert row["laser_returns"] == [0 if laser == SICK else 200 for laser in range(16)]
    found = catalogue_of(type(payload).from_pylist([row], METRICS))
    assert found.column("silent_lasers").to_pylist() == [silent]
    assert found.column("laser_bits").to_pylist() == found.column("laser_excess").to_pylist() == [None]
