"""Clouds in shards: one nullable struct a scan."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
import pyarrow as pa

from salpcc.schemas.cloud import Cloud

CLOUD = pa.field(
    "cloud",
    pa.struct(
        [
            pa.field("topic", pa.string(), nullable=False),
            pa.field("encoding", pa.string(), nullable=False),
            pa.field("head", pa.binary(), nullable=False),
            pa.field("tail", pa.binary(), nullable=False),
            pa.field("loose", pa.large_binary(), nullable=False),
            pa.field("rest", pa.large_binary(), nullable=False),
            pa.field("whole", pa.bool_(), nullable=False),
            pa.field("delay", pa.int64(), nullable=False),
            pa.field("sequence", pa.int64(), nullable=False),
            pa.field("channel", pa.int64(), nullable=False),
        ]
    ),
)


def cloud_column(clouds: Iterable[Cloud | None]) -> pa.Array:
    """Lay clouds out as a column of a shard."""
    rows = [cloud and {**vars(cloud), "rest": cloud.rest.tobytes()} for cloud in clouds]
    return pa.array(rows, CLOUD.type)


def column_cloud(table: pa.Table, row: int, n_points: int) -> Cloud | None:
    """Take the cloud of a sweep of ``n_points`` out of its row; inverse of :func:`cloud_column`."""
    values: dict[str, Any] | None = table.column("cloud")[row].as_py()
    if values is None:
        return None
    rest = np.frombuffer(bytearray(values["rest"]), np.uint8)
    cloud = Cloud(**{**values, "rest": rest[:, None]})
    return replace(cloud, rest=rest.reshape(n_points, len(cloud.layout.rest)))
