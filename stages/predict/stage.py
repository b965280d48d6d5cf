"""Predict: the level of every return from the returns before it, and how far off that may be."""

from __future__ import annotations

import pyarrow as pa

from salpcc.schemas.config import RunConfig
from salpcc.schemas.shards import PREDICTION, table_to_sweeps
from salpcc.stages.ingest.sensor_model import load_sensor
from salpcc.stages.predict.prediction import predict
from salpcc.stages.residual_code.models import effective_effort

VERSION = 2


def run(task: pa.Table, planes: pa.Table, config: RunConfig) -> pa.Table:
    """Turn a TASK table into a PREDICTION table.

    The neighbours' predictors follow planes by themselves (1/r is linear over a plane), so the fitted
    planes are not used in the ``sensor`` profile.
    """
    sensor = load_sensor(config.sensor)
    rows = []
    for sweep in table_to_sweeps(task):
        effort = effective_effort(sweep, sensor, config.effort)
        predicted = predict(sweep, sensor, effort)
        rows.append(
            {
                "name": sweep.name,
                "effort": effort,
                "prediction": predicted.level,
                "spread": predicted.spread,
            }
        )
    return pa.Table.from_pylist(rows, schema=PREDICTION)
