"""What a ``sensor_msgs/PointCloud2`` message holds besides x, y, z and intensity."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from salpcc.schemas.cloud_layout import Field, Layout, read_layout

_MOST_RINGS = 4096
RANGE_FIELDS = ("range", "distance")
TIME_FIELDS = (
    "time", "t", "timestamp", "time_stamp", "offset_time", "offset_ns", "time_offset", "timeOffset"
)  # fmt: skip
RING_FIELDS = ("ring", "channel", "laser_id", "line")  # names that drivers give to the number of the laser


@dataclass(frozen=True, eq=False)
class Cloud:
    """What of a message its scan does not hold elsewhere.

    Attributes:
        topic: that the message came on.
        delay: nanoseconds from the time that the log has it to its publish time, modulo 2^64, from -2^63 on.
        sequence: number that the log gives it.
        encoding: ``cdr`` or ``ros1``.
        head, tail: bytes of the message before and after the points.
        loose: bytes between the rows, row by row; empty where points were dropped.
        rest: ``(N, R)`` uint8, the bytes :attr:`Layout.rest` of each point, as they lay in the message.
        whole: no point was dropped.
        channel: id of the log's channel that it came on; 0 where topic and encoding tell.
    """

    topic: str
    encoding: str
    head: bytes
    tail: bytes
    loose: bytes
    rest: NDArray[np.uint8]
    whole: bool = True
    delay: int = 0
    sequence: int = 0
    channel: int = 0

    @property
    def layout(self) -> Layout:
        """How the points lay in the message."""
        return _layout_of(self.head, self.encoding)

    def keep(self, kept: NDArray[np.bool_]) -> Cloud:
        """Return it for the marked points ``(N,)`` only, in file order."""
        if kept.all():
            return self
        return replace(self, rest=self.rest[kept], loose=b"", whole=False)

    def rings(self) -> NDArray[np.int64] | None:
        """The sensor's own laser numbers ``(N,)``, 0 to 4095; None where the message has no such field."""
        field = next((c for c in self.layout.columns if c.name in RING_FIELDS), None)
        if field is None:
            return None
        numbers = self.values(field).astype(np.float64)
        with np.errstate(invalid="ignore"):
            sound = (numbers == np.rint(numbers)) & (numbers >= 0) & (numbers < _MOST_RINGS)
        return numbers.astype(np.int64) if sound.all() else None

    @property
    def range_field(self) -> Field | None:
        """The column of whole numbers that tells the distance of each point, if there is one."""
        return next((c for c in self.layout.columns if c.name in RANGE_FIELDS and c.dtype.kind in "iu"), None)

    @property
    def time_field(self) -> Field | None:
        """The column that tells the time of each point, if there is one."""
        return next((c for c in self.layout.columns if c.name in TIME_FIELDS and c.dtype.itemsize >= 4), None)

    @property
    def fields(self) -> dict[str, NDArray[np.generic]]:
        """Its fields by name, in their types: ``(N,)``, or ``(N, k)`` of k elements."""
        found: dict[str, list[NDArray[np.generic]]] = {}
        for column in self.layout.columns:
            if column.name:
                found.setdefault(column.name, []).append(self.values(column))
        return {name: np.column_stack(parts) if len(parts) > 1 else parts[0] for name, parts in found.items()}

    def values(self, column: Field) -> NDArray[np.generic]:
        """Values ``(N,)`` of one of the layout's columns, native byte order."""
        layout = self.layout
        start = int(np.searchsorted(layout.rest, column.offset))
        raw = np.ascontiguousarray(self.rest[:, start : start + column.dtype.itemsize])
        kind = column.dtype.newbyteorder(">" if layout.big_endian else "<")
        return raw.view(kind)[:, 0].astype(column.dtype)


@lru_cache(maxsize=64)
def _layout_of(head: bytes, encoding: str) -> Layout:
    return read_layout(head, encoding)
