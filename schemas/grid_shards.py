"""Shards of the ``paper`` profile: what its stages hand on where the ``sensor`` profile's tables do not fit."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from salpcc.schemas.grid import COLUMNS, ROWS, GridPrediction, GridSweep
from salpcc.schemas.shards import TASK, list_array, list_column, list_of

_FIELDS = [
    pa.field("name", pa.string(), nullable=False),
    pa.field("time", pa.uint64(), nullable=False),
    pa.field("frame_id", pa.string(), nullable=False),
    pa.field("n_points", pa.int64(), nullable=False),
    pa.field("accuracy", pa.float64(), nullable=False),
    pa.field("elevation", list_of(pa.int16()), nullable=False),
    pa.field("level", list_of(pa.int32()), nullable=False),
    pa.field("intensity", list_of(pa.float32()), nullable=False),
    pa.field("classes", list_of(pa.uint8())),
    pa.field("motion", list_of(pa.float64())),
]
_SCALARS = ("name", "time", "frame_id", "n_points", "accuracy")

# What a TASK table says of what was dropped goes on as it is.
_OF_TASK = tuple(field for field in TASK if field.name.startswith("dropped_"))
GRID_TASK = pa.schema([*_FIELDS, *_OF_TASK])
GRID_PLANES = pa.schema(
    [
        pa.field("name", pa.string(), nullable=False),
        pa.field("planes", list_of(pa.int32()), nullable=False),  # rows of region, height, two slopes
    ]
)
GRID_PREDICTION = pa.schema(
    [
        pa.field("name", pa.string(), nullable=False),
        pa.field("motion", list_of(pa.int32())),
        pa.field("level", list_of(pa.int32())),
        pa.field("spread", list_of(pa.uint8())),
    ]
)


def grids_to_table(sweeps: Iterable[GridSweep], task: pa.Table) -> pa.Table:
    """Lay grid sweeps out as a GRID_TASK table; ``task`` is the TASK table that they were made of."""
    rows = list(sweeps)
    columns = []
    for field in _FIELDS:
        values = [getattr(sweep, field.name) for sweep in rows]
        scalar = field.name in _SCALARS
        columns.append(pa.array(values, field.type) if scalar else list_column(values, field.type))
    columns += [task.column(field.name).combine_chunks() for field in _OF_TASK]
    return pa.Table.from_arrays(columns, schema=GRID_TASK)


def table_to_grids(table: pa.Table) -> list[GridSweep]:
    """Take the grid sweeps out of a GRID_TASK table; inverse of :func:`grids_to_table`."""
    sweeps = []
    for row in range(table.num_rows):
        values: dict[str, Any] = {name: table.column(name)[row].as_py() for name in _SCALARS}
        for field in _FIELDS:
            if field.name not in _SCALARS:
                values[field.name] = list_array(table, field.name, row)
        values["level"] = values["level"].reshape(ROWS, COLUMNS)
        sweeps.append(GridSweep(**values))
    return sweeps


def planes_to_table(names: Sequence[str], planes: Sequence[NDArray[np.int32]]) -> pa.Table:
    """Lay the planes ``(P, 4)`` of scans out as a GRID_PLANES table."""
    column = list_column(list(planes), GRID_PLANES.field("planes").type)
    return pa.Table.from_arrays([pa.array(names, pa.string()), column], schema=GRID_PLANES)


def table_to_planes(table: pa.Table) -> list[NDArray[np.int32]]:
    """Inverse of :func:`planes_to_table`, names apart."""
    arrays = [list_array(table, "planes", row) for row in range(table.num_rows)]
    return [np.zeros((0, 4), np.int32) if array is None else array.reshape(-1, 4) for array in arrays]


def grid_predictions_to_table(names: Sequence[str], rows: Sequence[GridPrediction]) -> pa.Table:
    """Lay the predictions of frames out as a GRID_PREDICTION table."""
    columns = [pa.array(names, pa.string())]
    for name in ("motion", "level", "spread"):
        columns.append(list_column([getattr(row, name) for row in rows], GRID_PREDICTION.field(name).type))
    return pa.Table.from_arrays(columns, schema=GRID_PREDICTION)


def table_to_grid_predictions(table: pa.Table) -> list[GridPrediction]:
    """Inverse of :func:`grid_predictions_to_table`, names apart."""
    rows = []
    for row in range(table.num_rows):
        arrays: dict[str, Any] = {
            name: list_array(table, name, row) for name in ("motion", "level", "spread")
        }
        for name in ("level", "spread"):
            if arrays[name] is not None:
                arrays[name] = arrays[name].reshape(ROWS, COLUMNS)
        rows.append(GridPrediction(**arrays))
    return rows
