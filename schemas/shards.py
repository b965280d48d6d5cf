"""Shards: one Arrow schema per edge of the pipeline, one row per scan (per plane for PLANES).

A shard is an Arrow IPC file (zstd) of one GOP. Its schema metadata says who wrote it from what;
readers refuse a newer major version and ignore keys they do not know.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from salpcc.schemas.cloud_column import CLOUD, cloud_column, column_cloud
from salpcc.schemas.errors import ShardError
from salpcc.schemas.prediction import Prediction
from salpcc.schemas.sweep import Sweep

SHARD_VERSION = "1.0"
_META_KEY = b"salpcc"


def list_of(kind: pa.DataType) -> pa.DataType:
    """List type without nulls inside."""
    return pa.list_(pa.field("item", kind, nullable=False))


_SWEEP_FIELDS = [
    pa.field("name", pa.string(), nullable=False),
    pa.field("time", pa.uint64(), nullable=False),
    pa.field("frame_id", pa.string(), nullable=False),
    pa.field("n_points", pa.int64(), nullable=False),
    pa.field("motion", list_of(pa.float64())),
    pa.field("step", pa.int32(), nullable=False),
    pa.field("max_error", pa.float64(), nullable=False),
    pa.field("laser", list_of(pa.uint8()), nullable=False),
    pa.field("tick", list_of(pa.int32()), nullable=False),
    pa.field("count", list_of(pa.int32()), nullable=False),
    pa.field("intensity", list_of(pa.float32()), nullable=False),
    pa.field("millimetre", list_of(pa.uint8()), nullable=False),
    pa.field("ulp", list_of(pa.uint8()), nullable=False),
    pa.field("classes", list_of(pa.uint8())),
    pa.field("stray_index", list_of(pa.int64()), nullable=False),
    pa.field("stray_points", list_of(pa.float32()), nullable=False),
    pa.field("stray_classes", list_of(pa.uint8())),
    pa.field("source", list_of(pa.int64())),
    pa.field("lead", list_of(pa.int64())),
    pa.field("labels", list_of(pa.uint32())),
    pa.field("stray_labels", list_of(pa.uint32())),
    CLOUD,
]
_SCALARS = ("name", "time", "frame_id", "n_points", "step", "max_error")
_ARRAYS = {f.name: f.type for f in _SWEEP_FIELDS if f.name not in (*_SCALARS, "cloud")}

SWEEP = pa.schema(_SWEEP_FIELDS)
# The classes of the source points that the task dropped, KEPT where it kept them; for the report only.
KEPT = 255
_DROPPED = pa.field("dropped_classes", list_of(pa.uint8()))
# The class of every source point as it was found, where the archive does not store it; for the report only.
_FOUND = pa.field("found_classes", list_of(pa.uint8()))
_MOVABLE = pa.field(
    "movable", pa.struct(_SWEEP_FIELDS)
)  # the movable layer of each scan, null where there is one only
TASK = pa.schema(
    [*_SWEEP_FIELDS, pa.field("dropped_movable", pa.int64(), nullable=False), _DROPPED, _FOUND, _MOVABLE]
)
PLANES = pa.schema(
    [
        pa.field("name", pa.string(), nullable=False),
        pa.field("region", pa.int32(), nullable=False),
        *(pa.field(k, pa.float64(), nullable=False) for k in "abcd"),
        pa.field("n_points", pa.int64(), nullable=False),
    ]
)
_PREDICTION_FIELDS = [
    pa.field("name", pa.string(), nullable=False),
    pa.field("effort", pa.string(), nullable=False),
    pa.field("residual", list_of(pa.int32())),
    pa.field("level_context", list_of(pa.uint8())),
    pa.field("intensity_context", list_of(pa.uint16())),
    pa.field("order", list_of(pa.uint8())),
    pa.field("range_interval", list_of(pa.uint32())),
    pa.field("intensity_interval", list_of(pa.uint32())),
]
PREDICTION = pa.schema([*_PREDICTION_FIELDS, pa.field("movable", pa.struct(_PREDICTION_FIELDS))])
# Of one layer of a scan: counts of points, and bytes by group of streams.
LAYER_COUNTS = ("n_points", "kept", "dropped_movable", "strays", "geometry", "intensity", "classes", "side")
_LAYER_FIELDS = [
    *(pa.field(k, pa.int64(), nullable=False) for k in LAYER_COUNTS),
    pa.field("data", pa.large_binary(), nullable=False),
    pa.field("coded_labels", pa.large_binary(), nullable=False),  # empty where there are none
]
# Of both layers: by laser the returns, and the bits of their ranges; and the returns that need no correction. For the report only.
OF_RETURNS = pa.schema(
    [
        pa.field("laser_returns", list_of(pa.int32())),
        pa.field("laser_bits", list_of(pa.float32())),
        pa.field("bit_identical", pa.int64()),  # null where all points are strays
    ]
)
PAYLOAD = pa.schema(
    [
        pa.field("name", pa.string(), nullable=False),
        pa.field("time", pa.uint64(), nullable=False),
        pa.field("frame_id", pa.string(), nullable=False),
        *_LAYER_FIELDS,
        pa.field("movable", pa.struct(_LAYER_FIELDS)),
        *OF_RETURNS,
        _DROPPED,
        _FOUND,
    ]
)

ASIDE = ("dropped_classes", "found_classes", *OF_RETURNS.names)  # in no archive

# The schema that each stage's table has; evaluate owns its own (one row per scan, any columns).


def sweeps_to_table(
    sweeps: Iterable[Sweep],
    dropped: Iterable[NDArray[np.uint8] | None] | None = None,
    found: Iterable[NDArray[np.uint8] | None] | None = None,
    movable: Iterable[Sweep] | None = None,
) -> pa.Table:
    """Lay sweeps out as a SWEEP table, or as a TASK table where ``dropped`` is given.

    Args:
        dropped: per sweep, the classes ``(n_points,)`` of what the sweep lacks as movable and KEPT elsewhere, None for nothing.
        found: the classes ``(n_points,)`` of all of it, None where they are not known or the sweep has them.
        movable: the movable layers, where there are any.
    """
    rows = list(sweeps)
    columns: list[pa.Array] = []
    for field in _SWEEP_FIELDS[:-1]:
        values = [getattr(sweep, field.name) for sweep in rows]
        array = list_column(values, field.type) if field.name in _ARRAYS else pa.array(values, field.type)
        columns.append(array)
    columns.append(cloud_column(sweep.cloud for sweep in rows))
    if dropped is None:
        return pa.Table.from_arrays(columns, schema=SWEEP)
    classes = list(dropped)
    counts = [0 if some is None else np.count_nonzero(some != KEPT) for some in classes]
    columns += [pa.array(counts, pa.int64()), list_column(classes, _DROPPED.type)]
    columns.append(list_column([None] * len(rows) if found is None else list(found), _FOUND.type))
    columns.append(_nested(None if movable is None else sweeps_to_table(movable), len(rows), _MOVABLE.type))
    return pa.Table.from_arrays(columns, schema=TASK)


def _nested(table: pa.Table | None, rows: int, kind: pa.StructType) -> pa.Array:
    """Put the rows of a table into one column."""
    if table is None:
        return pa.nulls(rows, kind)
    columns = [column.combine_chunks() for column in table.columns[: kind.num_fields]]
    return pa.StructArray.from_arrays(columns, fields=list(kind))


def _unnested(table: pa.Table, column: str) -> pa.Table | None:
    """Inverse of :func:`_nested`."""
    array = table.column(column).combine_chunks()
    if array.null_count == len(array):
        return None
    return pa.Table.from_arrays(array.flatten(), schema=pa.schema(list(array.type)))


def table_to_sweeps(table: pa.Table) -> list[Sweep]:
    """Take the sweeps out of a SWEEP or TASK table; inverse of :func:`sweeps_to_table`."""
    return [_row(table, i) for i in range(table.num_rows)]


def table_to_movable(table: pa.Table) -> list[Sweep] | None:
    """Take the movable layers out of a TASK table, None where it has none."""
    movable = _unnested(table, "movable")
    return None if movable is None else table_to_sweeps(movable)


_PREDICTED = (
    "residual",
    "level_context",
    "intensity_context",
    "order",
    "range_interval",
    "intensity_interval",
)


def predictions_to_table(
    names: Iterable[str], predictions: Iterable[Prediction], movable: Iterable[Prediction] | None = None
) -> pa.Table:
    """Lay the predictions of scans out as a PREDICTION table, with those of their ``movable`` layers if they have some."""
    rows, names = list(predictions), list(names)
    columns = [pa.array(names, pa.string()), pa.array([row.effort for row in rows], pa.string())]
    for name in _PREDICTED:
        columns.append(list_column([getattr(row, name) for row in rows], PREDICTION.field(name).type))
    nested = None if movable is None else predictions_to_table(names, movable)
    columns.append(_nested(nested, len(rows), PREDICTION.field("movable").type))
    return pa.Table.from_arrays(columns, schema=PREDICTION)


def table_to_predictions(table: pa.Table) -> list[Prediction]:
    """Take the predictions out of a PREDICTION table; inverse of :func:`predictions_to_table`."""
    predictions = []
    for row in range(table.num_rows):
        arrays: dict[str, Any] = {name: list_array(table, name, row) for name in _PREDICTED}
        for name in ("range_interval", "intensity_interval"):
            flat = arrays[name]
            arrays[name] = None if flat is None else flat.reshape(-1, 2)
        predictions.append(Prediction(table.column("effort")[row].as_py(), **arrays))
    return predictions


def table_to_movable_predictions(table: pa.Table) -> list[Prediction] | None:
    """Take those of the movable layers out of a PREDICTION table, None where it has none."""
    movable = _unnested(table, "movable")
    return None if movable is None else table_to_predictions(movable)


def list_column(values: list[NDArray[Any] | None], kind: pa.DataType) -> pa.ChunkedArray:
    """Build a list column from arrays of any shape, flattened, a chunk each: neither copied nor through Python objects (NaN bits are kept)."""
    dtype = kind.value_type.to_pandas_dtype()
    return pa.chunked_array([_list_of(value, kind, dtype) for value in values], kind)


def _list_of(value: NDArray[Any] | None, kind: pa.DataType, dtype: Any) -> pa.Array:
    if value is None:
        return pa.nulls(1, kind)
    flat = np.ascontiguousarray(value, dtype).ravel()
    return pa.ListArray.from_arrays(
        pa.array([0, len(flat)], pa.int32()), pa.array(flat, kind.value_type), type=kind
    )


def list_array(table: pa.Table, column: str, row: int) -> NDArray[Any] | None:
    """The array ``(n,)`` in a list column of one row, or None where it is null.

    A copy: Arrow's memory is read-only, and numba would compile every kernel a second time for it.
    """
    scalar = table.column(column)[row]
    return np.array(scalar.values.to_numpy()) if scalar.is_valid else None


def _row(table: pa.Table, row: int) -> Sweep:
    values: dict[str, Any] = {name: table.column(name)[row].as_py() for name in _SCALARS}
    values.update({name: list_array(table, name, row) for name in _ARRAYS})
    values["stray_points"] = values["stray_points"].reshape(-1, 4)
    sweep = Sweep(**values)
    return replace(sweep, cloud=column_cloud(table, row, len(sweep)))


def stamp(table: pa.Table, **facts: Any) -> pa.Table:
    """Put facts (stage, stage version, config digest, tool, errors, ...) into the schema metadata."""
    record = {"version": SHARD_VERSION, **facts}
    return table.replace_schema_metadata({_META_KEY: json.dumps(record, sort_keys=True)})


def facts_of(schema: pa.Schema, where: str = "shard") -> dict[str, Any]:
    """Read what :func:`stamp` wrote.

    Raises:
        ShardError: ``where`` is no shard of ours, or of a newer major version.
    """
    try:
        facts: dict[str, Any] = json.loads((schema.metadata or {})[_META_KEY])
        major = int(str(facts["version"]).split(".")[0])
    except (KeyError, ValueError, TypeError) as error:
        raise ShardError(f"{where}: not a shard of this tool") from error
    if major > int(SHARD_VERSION.split(".")[0]):
        raise ShardError(
            f"{where}: shard version {facts['version']} is newer than this tool reads ({SHARD_VERSION})"
        )
    return facts
