"""How the points of a ``sensor_msgs/PointCloud2`` message lie in it.

A message is three pieces: its *head* (everything up to the points), the points, its *tail*. The head says
how the points lie, so it is kept as it is and read again wherever the layout is wanted. Both serialisations
are read: ROS 2's CDR of either byte order, and ROS 1's.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

CDR, ROS1 = "cdr", "ros1"
MAX_POINTS = 1 << 22
MAX_ENVELOPE = 1 << 16  # head, tail and topic
MAX_POINT_STEP = 1 << 12
MAX_BYTES = 1 << 27  # of the points of one message; the largest sensors need a third
_MAX_FIELDS = 1024
_KINDS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
_FLOAT32, _FLOAT64 = 7, 8


class LayoutError(ValueError):
    """The bytes are no point cloud message, or one that cannot be."""


@dataclass(frozen=True)
class Field:
    """One named field of a point: byte offset, PointField datatype (1 to 8), number of elements."""

    name: str
    offset: int
    datatype: int
    count: int

    @property
    def dtype(self) -> np.dtype[np.generic]:
        """NumPy type of an element, native byte order."""
        return np.dtype(_KINDS[self.datatype])

    @property
    def span(self) -> range:
        """Bytes of its first element."""
        return range(self.offset, self.offset + self.dtype.itemsize)

    @property
    def at(self) -> slice:
        """The same, to index with."""
        return slice(self.offset, self.offset + self.dtype.itemsize)


@dataclass(frozen=True)
class Layout:
    """What the head of a message says. ``stamp`` is in nanoseconds, ``row_step`` as it was written.

    ``numbers`` are the places in the head of height, width, row_step and data length, by which a message
    of other points is made.
    """

    encoding: str
    order: str
    stamp: int
    frame_id: str
    height: int
    width: int
    fields: tuple[Field, ...]
    big_endian: bool
    point_step: int
    row_step: int
    data_length: int
    numbers: tuple[int, int, int, int]

    @property
    def n_points(self) -> int:
        """Points of the message, whatever they hold."""
        return self.height * self.width

    @property
    def stride(self) -> int:
        """Bytes from row to row. Some drivers write a row_step that is none: then rows lie packed."""
        packed = self.width * self.point_step
        return self.row_step if self.row_step * self.height == self.data_length else packed

    @property
    def loose_length(self) -> int:
        """Bytes of the data that belong to no point: padding of rows."""
        return self.data_length - self.n_points * self.point_step

    @cached_property
    def xyz(self) -> tuple[Field, Field, Field]:
        """The fields x, y and z, float32 or float64."""
        found = []
        for name in "xyz":
            field = next((f for f in self.fields if f.name == name), None)
            if field is None or field.count != 1 or field.datatype not in (_FLOAT32, _FLOAT64):
                raise LayoutError(f"its points have no field {name} of float32 or float64")
            found.append(field)
        x, y, z = found
        if set(x.span) & set(y.span) or set(x.span) & set(z.span) or set(y.span) & set(z.span):
            raise LayoutError("its fields x, y and z overlap")
        return x, y, z

    @cached_property
    def intensity(self) -> Field | None:
        """The field intensity, of any type, or None."""
        used = {b for field in self.xyz for b in field.span}
        for field in self.fields:
            if field.name == "intensity" and field.count == 1 and not used & set(field.span):
                return field
        return None

    @cached_property
    def slots(self) -> tuple[Field | None, Field | None, Field | None, Field | None]:
        """x, y, z and intensity where they are float32: these a scan holds in arrays of its own."""
        x, y, z, i = (
            field if field is not None and field.datatype == _FLOAT32 else None
            for field in (*self.xyz, self.intensity)
        )
        return x, y, z, i

    @cached_property
    def rest(self) -> NDArray[np.int64]:
        """Offsets of the bytes of a point that no slot holds, ascending."""
        free = np.ones(self.point_step, np.bool_)
        for field in self.slots:
            if field is not None:
                free[field.span] = False
        return np.flatnonzero(free)

    @cached_property
    def columns(self) -> tuple[Field, ...]:
        """The rest as columns of one element each: the fields by offset, then single bytes of padding."""
        free = np.zeros(self.point_step, np.bool_)
        free[self.rest] = True
        columns = []
        for field in sorted(self.fields, key=lambda f: f.offset):
            size = field.dtype.itemsize
            for element in range(field.count):
                start = field.offset + element * size
                if free[start : start + size].all():
                    columns.append(Field(field.name, start, field.datatype, 1))
                    free[start : start + size] = False
        columns += [Field("", int(byte), 2, 1) for byte in np.flatnonzero(free)]
        return tuple(columns)


def read_layout(head: bytes, encoding: str) -> Layout:
    """Read the head of a message; a whole message will do.

    Raises:
        LayoutError: it ends early, is of another encoding, or its numbers do not fit one another.
    """
    source = _Head(head, encoding)
    if encoding == ROS1:
        source.take("I")
    seconds, nanoseconds = source.take("I" if encoding == ROS1 else "i"), source.take("I")
    frame_id = source.text()
    height_at, height = source.at_next(4), source.take("I")
    width_at, width = source.at_next(4), source.take("I")
    n_fields = source.take("I")
    if n_fields > _MAX_FIELDS:
        raise LayoutError(f"it claims {n_fields} fields")
    fields = tuple(
        Field(source.text(), source.take("I"), source.take("B"), source.take("I")) for _ in range(n_fields)
    )
    big_endian = bool(source.take("B"))
    point_step = source.take("I")
    row_at, row_step = source.at_next(4), source.take("I")
    length_at, length = source.at_next(4), source.take("I")
    layout = Layout(
        encoding, source.order, seconds * 1_000_000_000 + nanoseconds, frame_id, height, width, fields,
        big_endian, point_step, row_step, length, (height_at, width_at, row_at, length_at),
    )  # fmt: skip
    _check(layout)
    return layout


def _check(layout: Layout) -> None:
    n, step = layout.n_points, layout.point_step
    if n > MAX_POINTS or step > MAX_POINT_STEP or layout.data_length > MAX_BYTES:
        raise LayoutError(f"it claims {n} points of {step} bytes in {layout.data_length} bytes, too many")
    if layout.data_length not in (layout.row_step * layout.height, n * step):
        raise LayoutError(
            f"{layout.height} x {layout.width} points of {step} bytes in rows of {layout.row_step} "
            f"do not make its {layout.data_length} bytes of data"
        )
    if layout.stride < layout.width * step:
        raise LayoutError(f"its rows of {layout.stride} bytes are too short for their points")
    for field in layout.fields:
        if field.datatype not in _KINDS:
            raise LayoutError(f"its field {field.name} has the unknown datatype {field.datatype}")
        if field.offset + field.count * field.dtype.itemsize > step:
            raise LayoutError(f"its field {field.name} lies outside the {step} bytes of a point")


def with_points(layout: Layout, head: bytes, n_points: int) -> bytes:
    """Return the head of a message of one row of ``n_points``."""
    row = n_points * layout.point_step
    out = bytearray(head)
    for at, value in zip(layout.numbers, (1, n_points, row, row), strict=True):
        struct.pack_into(layout.order + "I", out, at, value)
    return bytes(out)


def head_length(layout: Layout) -> int:
    """Bytes of the head."""
    return layout.numbers[3] + 4


class _Head:
    """Reads numbers and text; CDR aligns them to their size, counted from the end of its 4-byte header."""

    def __init__(self, data: bytes, encoding: str) -> None:
        self._data, self._aligned = data, encoding == CDR
        self.order, self._at = "<", 0
        if self._aligned:
            if data[:2] not in (b"\x00\x00", b"\x00\x01"):
                raise LayoutError("it is not plain CDR")
            self.order, self._at = "<" if data[1] else ">", 4

    def at_next(self, size: int) -> int:
        """Where a number of ``size`` bytes would be read next."""
        return self._at + (-(self._at - 4) % size if self._aligned else 0)

    def take(self, kind: str) -> int:
        size = struct.calcsize("<" + kind)
        at = self.at_next(size)
        if at + size > len(self._data):
            raise LayoutError("it ends early")
        self._at = at + size
        value: int = struct.unpack_from(self.order + kind, self._data, at)[0]
        return value

    def text(self) -> str:
        length = self.take("I")
        if length > len(self._data) - self._at:
            raise LayoutError(f"it ends early: a text of {length} bytes does not fit")
        raw = self._data[self._at : self._at + length]
        self._at += length
        return raw.rstrip(b"\x00").decode("utf-8", "replace")
