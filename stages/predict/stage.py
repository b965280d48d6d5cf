"""Predict: the level of every return from the returns before it, and how far off that may be."""

from __future__ import annotations

import pyarrow as pa

from salpcc.schemas.config import RunConfig
from salpcc.schemas.shards import PREDICTION, table_to_sweeps
from salpcc.stages.ingest.sensor_model import load_sensor
from salpcc.stages.predict.neighbours import laser_table, predict_levels, ring_starts

VERSION = 1


def run(task: pa.Table, planes: pa.Table, config: RunConfig) -> pa.Table:
    """Turn a TASK table into a PREDICTION table.

    The neighbours' predictors follow planes by themselves (1/r is linear over a plane), so the fitted
    planes are not used in the ``sensor`` profile.
    """
    sensor = load_sensor(config.sensor)
    table = laser_table(sensor)
    rows = []
    for sweep in table_to_sweeps(task):
        starts = ring_starts(sweep.laser, sensor.n_lasers)
        prediction, spread = predict_levels(starts, sweep.tick, sweep.count, sweep.step, table)
        rows.append({"name": sweep.name, "prediction": prediction, "spread": spread})
    return pa.Table.from_pylist(rows, schema=PREDICTION)
