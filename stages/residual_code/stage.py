"""Residual code: entropy-code every stream of every scan of a GOP into payloads."""

from __future__ import annotations

import pyarrow as pa

from salpcc.schemas.config import RunConfig
from salpcc.schemas.shards import PAYLOAD, table_to_predictions, table_to_sweeps
from salpcc.stages.ingest.sensor_model import load_sensor
from salpcc.stages.residual_code.models import GopModels
from salpcc.stages.residual_code.scan_coder import encode_scan

VERSION = 4


def run(task: pa.Table, planes: pa.Table, prediction: pa.Table, config: RunConfig) -> pa.Table:
    """Turn the TASK and PREDICTION tables of a GOP into its PAYLOAD table."""
    sensor = load_sensor(config.sensor)
    models = GopModels(sensor)
    rows = []
    for i, (sweep, predicted) in enumerate(
        zip(table_to_sweeps(task), table_to_predictions(prediction), strict=True)
    ):
        payload = encode_scan(sweep, sensor, predicted, models)
        rows.append(
            {
                "name": sweep.name,
                "time": sweep.time,
                "frame_id": sweep.frame_id,
                "n_points": sweep.n_points,
                "kept": len(sweep),
                "dropped_movable": task.column("dropped_movable")[i].as_py(),
                "strays": len(sweep.stray_index),
                "data": payload.data,
                **payload.sizes,
            }
        )
    table = pa.Table.from_pylist(rows, schema=PAYLOAD.remove(len(PAYLOAD) - 1))
    return table.append_column(PAYLOAD.field(len(PAYLOAD) - 1), task.column("dropped_classes"))
