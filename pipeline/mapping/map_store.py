"""Shards of a map: submaps in blocks of which a tile reads only its own, views, tiles, truths."""

from __future__ import annotations

import math
import zlib
from collections.abc import Sequence
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from salpcc.pipeline.schedule.store import ShardStore
from salpcc.schemas.errors import ShardError
from salpcc.schemas.work import ShardRef
from salpcc.stages.mapping.build import Built
from salpcc.stages.mapping.score import Truth
from salpcc.stages.mapping.view import COLUMNS, ROWS, View
from salpcc.stages.mapping.voxel import Voxels

F64 = NDArray[np.float64]

# Places are float32 from a corner that the shard's facts name: at 200 m that is 0.02 mm.
ENTRIES = pa.schema(
    [
        *((axis, pa.float32()) for axis in "xyz"),
        ("intensity", pa.float32()),
        ("class", pa.uint8()),
        ("count", pa.uint32()),
        ("scans", pa.uint16()),
    ]
)
_FATE = (("against", pa.uint8()), ("through", pa.uint16()), ("met", pa.uint16()))
TILE = pa.schema([*ENTRIES, *(pa.field(*column) for column in _FATE)])
_VIEWS = pa.schema(
    [("pose", pa.list_(pa.float64())), ("shift", pa.list_(pa.float64())), ("clear", pa.binary())]
)
TRUTH = pa.schema([("key", pa.int64()), *((kind, pa.int64()) for kind in ("static", "standing", "moving"))])


def entries_to_batch(voxels: Voxels, corner: F64) -> pa.RecordBatch:
    """Turn entries into columns; inverse: :func:`batch_to_entries`."""
    return pa.RecordBatch.from_arrays(_columns(voxels, corner), schema=ENTRIES)


def built_to_table(built: Built, corner: F64) -> pa.Table:
    """Turn a tile into columns; inverse: :func:`table_to_built`."""
    fate = [pa.array(getattr(built, name)) for name, _ in _FATE]
    return pa.Table.from_arrays([*_columns(built.voxels, corner), *fate], schema=TILE)


def table_to_built(table: pa.Table, corner: Sequence[float]) -> Built:
    """Turn columns back into a tile."""
    return Built(batch_to_entries(table, corner), *(np.array(table.column(name)) for name, _ in _FATE))


def _columns(voxels: Voxels, corner: F64) -> list[pa.Array]:
    local = (voxels.xyz - corner).astype(np.float32)
    columns = [*local.T.copy(), voxels.intensity, voxels.classes, voxels.count, voxels.scans]
    return [pa.array(column) for column in columns]


def batch_to_entries(table: pa.RecordBatch | pa.Table, corner: Sequence[float]) -> Voxels:
    """Turn columns back into entries."""

    def column(name: str) -> NDArray[np.generic]:
        return np.array(table.column(name))

    xyz = np.column_stack([column(axis) for axis in "xyz"]).astype(np.float64) + np.array(corner)
    return Voxels(
        xyz,
        column("intensity").astype(np.float32),
        column("class").astype(np.uint8),
        column("count").astype(np.uint32),
        column("scans").astype(np.uint16),
    )


def write_blocks(
    store: ShardStore,
    ref: ShardRef,
    blocks: Sequence[pa.RecordBatch],
    schema: pa.Schema,
    facts: dict[str, Any],
) -> None:
    """Write a shard of record batches that can be read one by one; inverse: :func:`read_blocks`."""
    table = pa.Table.from_batches(blocks, schema=schema)
    store.write(ref, table, {**facts, "block_crcs": [_crc_of(block) for block in blocks]})


def read_blocks(
    store: ShardStore, ref: ShardRef, blocks: Sequence[int]
) -> tuple[list[pa.RecordBatch], dict[str, Any]]:
    """Read some record batches of a shard, and its facts.

    Raises:
        ShardError: missing or damaged; what is damaged is deleted, so that the same command makes it again.
    """
    path, facts = store.root / ref.path, store.facts(ref)
    try:
        with pa.OSFile(str(path)) as file, pa.ipc.open_file(file) as reader:
            found = [reader.get_batch(block) for block in blocks]
    except (OSError, pa.ArrowException) as error:
        path.unlink(missing_ok=True)
        raise ShardError(f"{path}: {str(error).splitlines()[0]}; run the same command again") from error
    if [_crc_of(batch) for batch in found] != [facts["block_crcs"][block] for block in blocks]:
        path.unlink(missing_ok=True)
        raise ShardError(f"{path}: damaged (checksum differs); run the same command again")
    return found, facts


def _crc_of(batch: pa.RecordBatch) -> int:
    crc = 0
    for column in batch.columns:
        crc = zlib.crc32(np.array(column).tobytes(), crc)
    return crc


def views_to_table(views: Sequence[View]) -> pa.Table:
    """Turn views into a table; inverse: :func:`table_to_views`."""
    return pa.table(
        [
            [view.pose.ravel().tolist() for view in views],
            [view.shift.tolist() for view in views],
            [view.clear.tobytes() for view in views],
        ],
        schema=_VIEWS,
    )


def table_to_views(table: pa.Table) -> list[View]:
    """Turn a table back into views."""
    return [
        View(
            np.array(row["pose"]).reshape(4, 4),
            np.array(row["shift"]),
            np.frombuffer(row["clear"], np.uint16).reshape(ROWS, COLUMNS).copy(),
        )
        for row in table.to_pylist()
    ]


def truth_to_batch(truth: Truth) -> pa.RecordBatch:
    """Turn counts of labelled points into columns; inverse: :func:`batches_to_truth`."""
    columns = [truth.keys, *truth.points.T.copy()]
    return pa.RecordBatch.from_arrays([pa.array(column) for column in columns], schema=TRUTH)


def batches_to_truth(batches: Sequence[pa.RecordBatch]) -> Truth:
    """Add up the counts of several shards."""
    kinds = ("static", "standing", "moving")
    return Truth.together(
        [
            Truth(
                np.array(batch.column("key")),
                np.column_stack([np.array(batch.column(kind)) for kind in kinds]),
            )
            for batch in batches
        ]
    )


def whole_metres(place: F64) -> F64:
    """Return a corner for a shard's places: the whole metres below ``place`` ``(3,)``."""
    return np.array([math.floor(value) for value in place], np.float64)
