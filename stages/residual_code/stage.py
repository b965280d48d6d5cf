"""Residual code: entropy-code every stream of every scan of a GOP into payloads."""

from __future__ import annotations

from collections.abc import Iterator

import pyarrow as pa

from salpcc.schemas.config import RunConfig
from salpcc.schemas.grid import GridSweep
from salpcc.schemas.grid_shards import table_to_grid_predictions, table_to_grids, table_to_planes
from salpcc.schemas.shards import PAYLOAD, table_to_predictions, table_to_sweeps
from salpcc.schemas.sweep import Sweep
from salpcc.stages.lattice.sensor_model import load_sensor
from salpcc.stages.residual_code.paper.grid_coder import GridModels, encode_grid
from salpcc.stages.residual_code.sensor.gop_models import GopModels
from salpcc.stages.residual_code.sensor.payload import Payload
from salpcc.stages.residual_code.sensor.scan_coder import encode_scan

VERSION = 7


def run(task: pa.Table, planes: pa.Table, prediction: pa.Table, config: RunConfig) -> pa.Table:
    """Turn the TASK and PREDICTION tables of a GOP into its PAYLOAD table (profile ``paper``: their GRID twins)."""
    coded = (
        _grids(task, planes, prediction, config)
        if config.profile == "paper"
        else _sweeps(task, prediction, config)
    )
    rows = []
    for i, (sweep, payload) in enumerate(coded):
        rows.append(
            {
                "name": sweep.name,
                "time": sweep.time,
                "frame_id": sweep.frame_id,
                "n_points": sweep.n_points,
                "kept": len(sweep),
                "dropped_movable": task.column("dropped_movable")[i].as_py(),
                "strays": len(sweep.stray_index) if isinstance(sweep, Sweep) else 0,
                "data": payload.data,
                **payload.sizes,
            }
        )
    table = pa.Table.from_pylist(rows, schema=PAYLOAD.remove(len(PAYLOAD) - 1))
    return table.append_column(PAYLOAD.field(len(PAYLOAD) - 1), task.column("dropped_classes"))


def _sweeps(
    task: pa.Table, prediction: pa.Table, config: RunConfig
) -> Iterator[tuple[Sweep | GridSweep, Payload]]:
    sensor = load_sensor(config.sensor)
    models = GopModels(sensor)
    for sweep, predicted in zip(table_to_sweeps(task), table_to_predictions(prediction), strict=True):
        yield sweep, encode_scan(sweep, sensor, predicted, models)


def _grids(
    task: pa.Table, planes: pa.Table, prediction: pa.Table, config: RunConfig
) -> Iterator[tuple[Sweep | GridSweep, Payload]]:
    models = GridModels(config.coder)
    given = zip(
        table_to_grids(task), table_to_planes(planes), table_to_grid_predictions(prediction), strict=True
    )
    for sweep, fitted, predicted in given:
        yield sweep, encode_grid(sweep, fitted, predicted, models)
