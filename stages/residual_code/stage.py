"""Residual code: entropy-code every stream of every scan of a GOP into payloads."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from salpcc.schemas.config import RunConfig
from salpcc.schemas.grid import GridSweep
from salpcc.schemas.grid_shards import table_to_grid_predictions, table_to_grids, table_to_planes
from salpcc.schemas.prediction import Prediction
from salpcc.schemas.shards import (
    PAYLOAD,
    stamp,
    table_to_movable,
    table_to_movable_predictions,
    table_to_predictions,
    table_to_sweeps,
)
from salpcc.schemas.sweep import Sweep
from salpcc.stages.lattice.lattice import NO_CORRECTION
from salpcc.stages.lattice.sensor_model import SensorModel, load_sensor
from salpcc.stages.predict.laser_bits import laser_bits
from salpcc.stages.predict.ring_starts import ring_starts
from salpcc.stages.residual_code.gop import encode_gop
from salpcc.stages.residual_code.label_coder import encode_labels
from salpcc.stages.residual_code.paper.grid_coder import encode_grid
from salpcc.stages.residual_code.paper.grid_streams import GridState
from salpcc.stages.residual_code.sensor.scan_coder import on_lattice
from salpcc.stages.residual_code.stream import Payload

VERSION = 19


def run(task: pa.Table, planes: pa.Table, prediction: pa.Table, config: RunConfig) -> pa.Table:
    """Turn the TASK and PREDICTION tables of a GOP into its PAYLOAD table (profile ``paper``: their GRID twins).

    Its facts say under ``apart`` how many CPU milliseconds the labels took, which are no part of the codec.
    """
    coded = (
        _grids(task, planes, prediction, config)
        if config.profile == "paper"
        else _sweeps(task, prediction, config)
    )
    sensor = load_sensor(config.sensor)
    rows, labels_ms = [], 0.0

    def layer(sweep: Sweep | GridSweep, payload: Payload, dropped: int) -> dict[str, Any]:
        nonlocal labels_ms
        start = time.thread_time()
        labelled = isinstance(sweep, Sweep) and sweep.labels is not None
        coded = encode_labels(sweep, sensor) if isinstance(sweep, Sweep) and labelled else b""
        labels_ms += 1e3 * (time.thread_time() - start)
        return _layer(sweep, payload, dropped) | {"coded_labels": coded}

    for i, (sweep, payload, movable, of_returns) in enumerate(coded):
        dropped = task.column("dropped_movable")[i].as_py()
        rows.append(
            {
                "name": sweep.name,
                "time": sweep.time,
                "frame_id": sweep.frame_id,
                **layer(sweep, payload, dropped),
                "movable": movable and layer(*movable, 0),
                **of_returns,
            }
        )
    of_task = ("dropped_classes", "found_classes")
    fields = [field for field in PAYLOAD if field.name not in of_task]
    table = pa.Table.from_pylist(rows, schema=pa.schema(fields))
    for name in of_task:
        known = name in task.column_names
        column = task.column(name) if known else pa.nulls(len(rows), PAYLOAD.field(name).type)
        table = table.append_column(PAYLOAD.field(name), column)
    return stamp(table, apart={"labels": labels_ms}) if any(row["coded_labels"] for row in rows) else table


def _layer(sweep: Sweep | GridSweep, payload: Payload, dropped: int) -> dict[str, Any]:
    return {
        "n_points": sweep.n_points,
        "kept": len(sweep),
        "dropped_movable": dropped,
        "strays": len(sweep.stray_index) if isinstance(sweep, Sweep) else 0,
        "data": payload.data,
        **payload.sizes,
    }


# A scan or its static layer, the movable one, and what is known of its returns.
_Coded = tuple[Sweep | GridSweep, Payload, tuple[Sweep, Payload] | None, dict[str, Any]]


def _sweeps(task: pa.Table, prediction: pa.Table, config: RunConfig) -> Iterator[_Coded]:
    sensor = load_sensor(config.sensor)
    sweeps, predicted = table_to_sweeps(task), table_to_predictions(prediction)
    coded = zip(sweeps, encode_gop(sweeps, sensor, config.effort, predicted), predicted, strict=True)
    layers, guessed = table_to_movable(task), table_to_movable_predictions(prediction)
    if layers is None or guessed is None:
        for static in coded:
            yield *static[:2], None, _of_returns(sensor, static)
        return
    moving = zip(layers, encode_gop(layers, sensor, config.effort, guessed, sweeps), guessed, strict=True)
    for static, movable in zip(coded, moving, strict=True):
        yield *static[:2], movable[:2], _of_returns(sensor, static, movable)


def _of_returns(sensor: SensorModel, *layers: tuple[Sweep, Payload, Prediction]) -> dict[str, Any]:
    """What is known of a scan's returns and their lasers: nothing of points that are on no lattice, or of which nobody tells the laser."""
    if any(len(sweep.laser) for sweep, _, _ in layers):
        returns = sum(np.diff(ring_starts(sweep.laser, sensor.n_lasers)) for sweep, _, _ in layers)
        bits = sum(laser_bits(sweep, predicted, sensor.n_lasers) for sweep, _, predicted in layers)
        return {
            "laser_returns": np.asarray(returns, np.int32),
            "laser_bits": np.asarray(bits, np.float32),
            "bit_identical": sum(_bit_identical(sweep) for sweep, _, _ in layers),
        }
    filled = [sweep for sweep, _, _ in layers if len(sweep)]
    told = [n for sweep in filled if (n := _told_returns(sweep, sensor.n_lasers)) is not None]
    if not told or len(told) < len(filled):
        return {}
    off = sum(on_lattice(payload.data).off for _, payload, _ in layers)
    if 2 * off > sum(len(sweep) for sweep in filled):
        return {}
    return {"laser_returns": np.sum(told, axis=0, dtype=np.int32)}


def _bit_identical(sweep: Sweep) -> int:
    """Count the returns that come back to the bit without a correction; none of a sweep within an error."""
    plain = (sweep.millimetre == NO_CORRECTION) & (sweep.ulp == NO_CORRECTION)
    return int(np.count_nonzero(plain)) if sweep.max_error == 0 else 0


def _told_returns(sweep: Sweep, n_lasers: int) -> NDArray[np.int64] | None:
    """Points ``(n_lasers,)`` by the rings that a recorded message tells, placeholders left out; None without such rings."""
    rings = None if sweep.cloud is None else sweep.cloud.rings()
    if rings is None or rings.max(initial=0) >= n_lasers:
        return None
    places = sweep.stray_points[:, :3]
    returned = np.isfinite(places).all(axis=1) & places.any(axis=1)
    return np.bincount(rings[returned], minlength=n_lasers)


def _grids(task: pa.Table, planes: pa.Table, prediction: pa.Table, config: RunConfig) -> Iterator[_Coded]:
    models = GridState(config.coder)
    given = zip(
        table_to_grids(task), table_to_planes(planes), table_to_grid_predictions(prediction), strict=True
    )
    for sweep, fitted, predicted in given:
        yield sweep, encode_grid(sweep, fitted, predicted, models), None, {}
