"""The cloud section of a payload: what a recorded message held besides its points' coordinates.

The head and tail of a message hardly change from scan to scan, so they are coded against the ones before.
The fields are coded one by one, in file order, with the decoded points known.
"""

from __future__ import annotations

import struct
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from salpcc.schemas.cloud import Cloud
from salpcc.schemas.cloud_layout import CDR, MAX_BYTES, MAX_ENVELOPE, ROS1, Layout, LayoutError
from salpcc.schemas.errors import ArchiveError
from salpcc.stages.entropy.buffer import require_sound
from salpcc.stages.entropy.bytes import decode_bytes, encode_bytes
from salpcc.stages.lattice.layers import Layered
from salpcc.stages.lattice.sensor_model import SensorModel
from salpcc.stages.lists.list_coder import Told
from salpcc.stages.residual_code.message.field_modes import FieldModes
from salpcc.stages.residual_code.message.points import Points
from salpcc.stages.residual_code.message.records import unpacked

_WHOLE, _ROS1, _CHANNEL = 1, 2, 4
_LOOSE = 8  # of a movable layer, the loose bytes of the whole message
_DIM = 16  # intensities of points without a return
_NUMBERS = struct.Struct("<qI")
_DIM_FIELD = "/dim"  # no field of a message is called so
_ID = struct.Struct("<H")
_SECTION = struct.Struct("<BIIIII")  # flags, lengths of topic, head, tail, their code, the loose bytes


def encode_cloud(
    cloud: Cloud,
    points: NDArray[np.float32],
    exact: bool,
    before: bytearray,
    known: Points,
    modes: FieldModes,
    dim: NDArray[np.float32] | None = None,
) -> tuple[bytes, Cloud]:
    """Encode what a cloud adds to the decoded points ``(N, 3)`` of a scan.

    Args:
        exact: the points are; float64 coordinates are then coded in full, else they follow the points.
        before: the envelope of the scan before; becomes that of this scan.
        known: of these points, by :func:`points_of`.
        modes: of the fields of the group's scans.
        dim: intensities ``(N,)`` of points without a return, 0 of the others; None where they are not told here.

    Returns:
        the section, and the cloud as it will be decoded.
    """
    topic = cloud.topic.encode()
    envelope = _NUMBERS.pack(cloud.delay, cloud.sequence) + topic + cloud.head + cloud.tail
    envelope += _ID.pack(cloud.channel) if cloud.channel else b""
    code = encode_bytes(envelope, before)
    loose = encode_bytes(cloud.loose, bytearray())
    layout = cloud.layout
    flags = cloud.whole * _WHOLE + (cloud.encoding == ROS1) * _ROS1 + (cloud.channel > 0) * _CHANNEL
    flags |= (bool(cloud.loose) and not cloud.whole) * _LOOSE | (dim is not None) * _DIM
    parts = [
        _SECTION.pack(flags, len(topic), len(cloud.head), len(cloud.tail), len(code), len(loose)),
        code,
        loose,
    ]
    columns = []
    for field, base in _columns(layout, points):
        values = cloud.values(field)
        if base is not None and not exact:
            values = base
        else:
            parts.append(modes.encode((cloud.topic, field.name), values, known, base))
        columns.append(values)
    if dim is not None:
        parts.append(modes.encode((cloud.topic, _DIM_FIELD), dim, known))
    return b"".join(parts), replace(cloud, rest=_rest(layout, columns, len(points)))


def decode_cloud(
    section: bytes,
    n_points: int,
    points: NDArray[np.float32],
    exact: bool,
    before: bytearray,
    modes: FieldModes,
    sensor: SensorModel | None = None,
    told: Told = None,
    layered: Layered | None = None,
    source: NDArray[np.int64] | None = None,
) -> tuple[Cloud, NDArray[np.float32] | None, Points]:
    """Inverse of :func:`encode_cloud`: the cloud, ``dim``, and what is known of the points.

    Args:
        n_points: points of the source scan, dropped ones included.
        source: places of the points in their organised cloud, where others were taken out of it.

    Raises:
        ArchiveError: the section is damaged.
    """
    (flags, n_topic, n_head, n_tail, n_code, n_loose), at = unpacked(_SECTION, section, 0)
    at += n_code + n_loose
    n_id = _ID.size if flags & _CHANNEL else 0
    require_sound(flags <= 31, n_topic + n_head + n_tail <= MAX_ENVELOPE, at <= len(section))
    code = section[_SECTION.size : _SECTION.size + n_code]
    envelope = decode_bytes(code, _NUMBERS.size + n_topic + n_head + n_tail + n_id, before)
    delay, sequence = _NUMBERS.unpack_from(envelope)
    (channel,) = _ID.unpack(envelope[-n_id:]) if n_id else (0,)
    envelope = envelope[_NUMBERS.size : len(envelope) - n_id]
    head, tail = envelope[n_topic : n_topic + n_head], envelope[n_topic + n_head :]
    cloud = Cloud(
        envelope[:n_topic].decode("utf-8", "replace"),
        ROS1 if flags & _ROS1 else CDR,
        head,
        tail,
        b"",
        np.empty((len(points), 0), np.uint8),
        bool(flags & _WHOLE),
        delay,
        sequence,
        channel,
    )
    try:
        layout = cloud.layout
        layout.columns  # noqa: B018 (x, y and z may be missing)
    except LayoutError as error:
        raise ArchiveError(f"payload holds a message that cannot be: {error}") from error
    sound = layout.n_points == n_points and len(points) * layout.point_step <= MAX_BYTES
    if not sound or (cloud.whole and len(points) != n_points) or layout.numbers[3] + 4 != n_head:
        raise ArchiveError("payload holds a message of other points")
    if cloud.whole or flags & _LOOSE:
        raw = section[at - n_loose : at]
        cloud = replace(cloud, loose=decode_bytes(raw, layout.loose_length, bytearray()))
    known = points_of(points, cloud, sensor, told, layered, source)
    columns = []
    for field, base in _columns(layout, points):
        if base is not None and not exact:
            values = base
        else:
            values, at = modes.decode((cloud.topic, field.name), section, at, field.dtype, known, base)
        columns.append(values)
    dim = None
    if flags & _DIM:
        dim, at = modes.decode((cloud.topic, _DIM_FIELD), section, at, np.dtype(np.float32), known)
    require_sound(at == len(section))
    return replace(cloud, rest=_rest(layout, columns, len(points))), dim, known


def points_of(
    points: NDArray[np.float32],
    cloud: Cloud,
    sensor: SensorModel | None = None,
    told: Told = None,
    layered: Layered | None = None,
    source: NDArray[np.int64] | None = None,
) -> Points:
    """What the fields of a scan are predicted from: its decoded points ``(N, 3)``, and how they lie."""
    layout = cloud.layout
    width = layout.width if (cloud.whole or source is not None) and layout.height > 1 else 0
    places = None if source is None else (source, layout.n_points)
    return Points.of(points, width, sensor, told, layered, places)


def _columns(layout: Layout, points: NDArray[np.float32]) -> list[tuple[Any, NDArray[np.float64] | None]]:
    """The columns of the rest, each with what it is close to: a float64 coordinate with its float32."""
    axes = {field.offset: axis for axis, field in enumerate(layout.xyz) if field.datatype == 8}
    return [
        (f, points[:, axes[f.offset]].astype(np.float64) if f.offset in axes and f.datatype == 8 else None)
        for f in layout.columns
    ]


def _rest(layout: Layout, columns: list[NDArray[Any]], n: int) -> NDArray[np.uint8]:
    """Put columns together as :attr:`Cloud.rest`."""
    rest = np.empty((n, len(layout.rest)), np.uint8)
    for field, values in zip(layout.columns, columns, strict=True):
        kind = field.dtype.newbyteorder(">" if layout.big_endian else "<")
        start = int(np.searchsorted(layout.rest, field.offset))
        bits = np.ascontiguousarray(values.astype(kind)) if kind.kind != "f" else _swapped(values, kind)
        rest[:, start : start + kind.itemsize] = bits.view(np.uint8).reshape(n, kind.itemsize)
    return rest


def _swapped(values: NDArray[Any], kind: np.dtype[Any]) -> NDArray[Any]:
    """Floats in another byte order as integers, so that no bit of a NaN changes on the way."""
    whole = np.dtype(f"u{kind.itemsize}")
    return np.ascontiguousarray(values).view(whole).astype(whole.newbyteorder(kind.byteorder))
