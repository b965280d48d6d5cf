"""ROS 2 messages that this pipeline writes, and their CDR bytes (little endian).

``point_cloud_interfaces/msg/CompressedPointCloud2`` carries a coded scan in an archive;
``sensor_msgs/msg/PointCloud2`` a decoded one. They differ in the name of the data field and in ``format``.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

from salpcc.schemas.errors import ArchiveError

COMPRESSED = "point_cloud_interfaces/msg/CompressedPointCloud2"
PLAIN = "sensor_msgs/msg/PointCloud2"

_PARTS = """\
{rule}
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
{rule}
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
{rule}
MSG: sensor_msgs/PointField
uint8 INT8=1
uint8 UINT8=2
uint8 INT16=3
uint8 UINT16=4
uint8 INT32=5
uint8 UINT32=6
uint8 FLOAT32=7
uint8 FLOAT64=8
string name
uint32 offset
uint8 datatype
uint32 count
""".format(rule="=" * 80)

_FIELDS = """\
std_msgs/Header header
uint32 height
uint32 width
sensor_msgs/PointField[] fields
bool is_bigendian
uint32 point_step
uint32 row_step
uint8[] {data}
bool is_dense
"""

# The text that MCAP tools parse ("ros2msg" encoding): the message, then what it is made of.
SCHEMA_TEXT = {
    COMPRESSED: _FIELDS.format(data="compressed_data") + "string format\n" + _PARTS,
    PLAIN: _FIELDS.format(data="data") + _PARTS,
}

# name, offset, datatype (7 is float32), count
XYZI: tuple[tuple[str, int, int, int], ...] = (
    ("x", 0, 7, 1),
    ("y", 4, 7, 1),
    ("z", 8, 7, 1),
    ("intensity", 12, 7, 1),
)
LABEL: tuple[tuple[str, int, int, int], ...] = (("label", 0, 6, 1),)  # uint32


@dataclass(frozen=True)
class CloudMessage:
    """One point cloud message. ``format`` is None in the plain kind, a string in the compressed one.

    ``stamp`` is in nanoseconds, ``width`` in points, ``data`` the points or the coded scan.
    """

    stamp: int
    frame_id: str
    width: int
    data: bytes
    format: str | None = None
    is_dense: bool = True
    height: int = 1
    point_step: int = 16
    fields: tuple[tuple[str, int, int, int], ...] = XYZI

    def to_cdr(self) -> bytes:
        """Serialise as CDR, version 1, little endian."""
        out = _Writer()
        seconds, nanoseconds = divmod(self.stamp, 1_000_000_000)
        out.put("<i", (seconds + 2**31) % 2**32 - 2**31)  # ROS has no more than 32 bits for them
        out.put("<I", nanoseconds)
        out.text(self.frame_id)
        out.put("<I", self.height)
        out.put("<I", self.width)
        out.put("<I", len(self.fields))
        for name, offset, datatype, count in self.fields:
            out.text(name)
            out.put("<I", offset)
            out.put("<B", datatype)
            out.put("<I", count)
        out.put("<B", 0)
        out.put("<I", self.point_step)
        out.put("<I", self.point_step * self.width)
        out.put("<I", len(self.data))
        out.bytes += self.data
        out.put("<B", self.is_dense)
        if self.format is not None:
            out.text(self.format)
        return bytes(out.bytes)

    @classmethod
    def from_cdr(cls, data: bytes, compressed: bool) -> CloudMessage:
        """Parse CDR bytes; inverse of :meth:`to_cdr`.

        Raises:
            ArchiveError: the bytes end early or are not little-endian CDR.
        """
        source = _Reader(data)
        stamp = source.take("<i") * 1_000_000_000 + source.take("<I")
        frame_id = source.text()
        height, width, n_fields = source.take("<I"), source.take("<I"), source.take("<I")
        if n_fields > 1024:
            raise ArchiveError(f"point cloud message claims {n_fields} fields")
        fields = tuple(
            (source.text(), source.take("<I"), source.take("<B"), source.take("<I")) for _ in range(n_fields)
        )
        if source.take("<B"):
            raise ArchiveError("point cloud message is big endian")
        point_step, _ = source.take("<I"), source.take("<I")
        content = source.slice(source.take("<I"))
        is_dense = bool(source.take("<B"))
        name = source.text() if compressed else None
        return cls(stamp, frame_id, width, content, name, is_dense, height, point_step, fields)


class _Writer:
    """CDR output: numbers are aligned to their size, counted from the end of the 4-byte header."""

    def __init__(self) -> None:
        self.bytes = bytearray(b"\x00\x01\x00\x00")

    def put(self, kind: str, value: int) -> None:
        self.bytes += bytes(-(len(self.bytes) - 4) % struct.calcsize(kind)) + struct.pack(kind, value)

    def text(self, value: str) -> None:
        raw = value.encode() + b"\x00"
        self.put("<I", len(raw))
        self.bytes += raw


class _Reader:
    """CDR input; every length is checked against what is there."""

    def __init__(self, data: bytes) -> None:
        if data[:4] not in (b"\x00\x01\x00\x00",):
            raise ArchiveError("message is not little-endian CDR")
        self.data, self.at = data, 4

    def slice(self, length: int) -> bytes:
        if length > len(self.data) - self.at:
            raise ArchiveError(
                f"message ends early: {length} bytes announced, {len(self.data) - self.at} left"
            )
        self.at += length
        return self.data[self.at - length : self.at]

    def take(self, kind: str) -> int:
        size = struct.calcsize(kind)
        self.at += -(self.at - 4) % size
        value: int = struct.unpack(kind, self.slice(size))[0]
        return value

    def text(self) -> str:
        try:
            return self.slice(self.take("<I"))[:-1].decode()
        except UnicodeDecodeError as error:
            raise ArchiveError("message holds text that is not UTF-8") from error
