"""Predict: every value from those before it, and how sure that is."""

from __future__ import annotations

import pyarrow as pa

from salpcc.schemas.config import RunConfig
from salpcc.schemas.grid_shards import grid_predictions_to_table, table_to_grids
from salpcc.schemas.shards import predictions_to_table, table_to_movable, table_to_sweeps
from salpcc.stages.lattice.sensor_model import load_sensor
from salpcc.stages.predict.paper.frames import predict_gop
from salpcc.stages.predict.values import predict_sweeps

VERSION = 9


def run(task: pa.Table, planes: pa.Table, config: RunConfig) -> pa.Table:
    """Turn a TASK table into a PREDICTION table.

    Profile ``paper``: a GRID_PREDICTION table, from the planes, too.
    """
    if config.profile == "paper":
        return grid_predictions_to_table(task.column("name").to_pylist(), predict_gop(table_to_grids(task)))
    sensor = load_sensor(config.sensor)
    sweeps = table_to_sweeps(task)
    movable = table_to_movable(task)
    return predictions_to_table(
        [sweep.name for sweep in sweeps],
        predict_sweeps(sweeps, sensor, config.effort),
        None if movable is None else predict_sweeps(movable, sensor, config.effort),
    )
