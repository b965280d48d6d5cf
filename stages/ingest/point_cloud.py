"""A recorded point cloud message <-> a scan. No byte is lost: a scan gives its message back as it was."""

from __future__ import annotations

import re
from itertools import count
from typing import Any

import numpy as np
from numpy.typing import NDArray

from salpcc.schemas.cloud import Cloud
from salpcc.schemas.cloud_layout import (
    MAX_ENVELOPE,
    Field,
    Layout,
    LayoutError,
    head_length,
    read_layout,
    with_points,
)
from salpcc.schemas.log import LogMessage
from salpcc.schemas.scan import Scan
from salpcc.stages.entropy.number_forms import spans_of

Bytes = NDArray[np.uint8]


def message_to_scan(message: LogMessage, encoding: str, topic: str, name: str) -> Scan:
    """Take a serialised ``sensor_msgs/PointCloud2`` apart.

    float64 coordinates are rounded to float32 in ``points``; their own bytes stay in ``cloud.rest``.

    Args:
        encoding: ``cdr`` or ``ros1``.

    Raises:
        LayoutError: it is not such a message, or its numbers do not fit one another.
    """
    raw = message.data
    layout = read_layout(raw, encoding)
    start, n, step = head_length(layout), layout.n_points, layout.point_step
    end = start + layout.data_length
    if end + 1 > len(raw):
        raise LayoutError(
            f"it ends early: {layout.data_length} bytes of points announced, {len(raw) - start} there"
        )
    if len(topic.encode()) + len(raw) - layout.data_length > MAX_ENVELOPE:
        raise LayoutError(f"it has {len(raw) - layout.data_length} bytes besides its points")
    data = np.frombuffer(raw, np.uint8, layout.data_length, start)
    rows, loose = data[:0].reshape(0, step), data.tobytes()
    if n:
        lines = data.reshape(layout.height, layout.stride)
        rows = lines[:, : layout.width * step].reshape(n, step)
        loose = lines[:, layout.width * step :].tobytes()
    points = np.empty((n, 3), np.float32)
    for axis, field in enumerate(layout.xyz):
        points[:, axis] = _float32(rows, field, layout)
    rest = rows[:, layout.rest]
    delay = (message.publish_time - message.log_time + 2**63) % 2**64 - 2**63
    cloud = Cloud(
        topic, encoding, raw[:start], raw[end:], loose, rest, delay=delay, sequence=message.sequence
    )
    slot = layout.slots[3]
    intensity = intensity_of(cloud) if slot is None else _float32(rows, slot, layout)
    return Scan(name, points, intensity, message.log_time, layout.frame_id, cloud=cloud)


def scan_to_message(scan: Scan) -> bytes:
    """Put the message of a scan together again; inverse of :func:`message_to_scan`.

    Where points were dropped, the message has one row of those that are left.
    """
    cloud = scan.cloud
    assert cloud is not None
    layout = cloud.layout
    rows = point_rows(scan)
    if not cloud.whole:
        return with_points(layout, cloud.head, len(scan)) + rows.tobytes() + cloud.tail
    if not cloud.loose or not len(scan):
        return cloud.head + rows.tobytes() + cloud.loose + cloud.tail
    lines = rows.reshape(layout.height, -1)
    loose = np.frombuffer(cloud.loose, np.uint8).reshape(layout.height, -1)
    return cloud.head + np.hstack([lines, loose]).tobytes() + cloud.tail


def point_rows(scan: Scan) -> Bytes:
    """Return the bytes ``(N, point_step)`` of the points of a scan that has a cloud."""
    cloud = scan.cloud
    assert cloud is not None
    layout = cloud.layout
    rows = np.empty((len(scan), layout.point_step), np.uint8)
    rows[:, layout.rest] = cloud.rest
    for values, field in zip((*scan.points.T, scan.intensity), layout.slots, strict=True):
        if field is not None:
            bits = np.ascontiguousarray(values).view(np.uint32)
            kind = ">u4" if layout.big_endian else "<u4"
            rows[:, field.at] = bits.astype(kind).view(np.uint8).reshape(-1, 4)
    return rows


def scan_columns(scan: Scan) -> dict[str, NDArray[Any]]:
    """Return every field ``(N,)`` of a scan under its own name and with its own type, in the recorded order.

    Further elements of a field, and a field named like one before it, go under names that are free: NAME_1, NAME_2 …
    """
    if scan.cloud is None:
        columns: dict[str, NDArray[Any]] = dict(zip("xyz", scan.points.T, strict=True))
        columns["intensity"] = scan.intensity
        return columns if scan.offset is None else columns | {"t": scan.offset}
    layout = scan.cloud.layout
    rows = point_rows(scan)
    names = [re.sub("[^!-~]", "_", field.name) or "unnamed" for field in layout.fields]
    taken = set(names)
    columns = {}
    for name, field in zip(names, layout.fields, strict=True):
        kind = field.dtype.newbyteorder(">" if layout.big_endian else "<")
        for element in range(max(field.count, 1)):  # some drivers say 0 and mean 1
            start = field.offset + element * kind.itemsize
            if start + kind.itemsize <= layout.point_step:
                raw = np.ascontiguousarray(rows[:, start : start + kind.itemsize])
                free = name if name not in columns else free_name(name, taken)
                columns[free] = raw.view(kind)[:, 0].astype(field.dtype)
    return columns


def add_column(columns: dict[str, NDArray[Any]], name: str, values: NDArray[Any]) -> None:
    """Add values ``(N,)`` to the columns of a scan, under another name where a field has this one."""
    columns[free_name(name, set(columns)) if name in columns else name] = values


def free_name(name: str, taken: set[str]) -> str:
    """Return NAME_1, or the first such name that is not taken, and take it."""
    free = next(f"{name}_{n}" for n in count(1) if f"{name}_{n}" not in taken)
    taken.add(free)
    return free


def coordinate_rounding(scan: Scan) -> float:
    """The largest distance, in metres, of a point's float64 coordinates from its float32 ones; 0 without such."""
    if scan.cloud is None or None not in scan.cloud.layout.slots[:3]:
        return 0.0
    columns = scan_columns(scan)
    wide = [columns[axis].astype(np.float64) for axis in "xyz"]
    with np.errstate(invalid="ignore", over="ignore"):
        # What is not finite stays so; what float32 cannot hold is infinitely far off.
        off = [np.where(np.isfinite(v), v - scan.points[:, i], 0.0) for i, v in enumerate(wide)]
        return float(np.sqrt(sum(np.square(axis) for axis in off)).max(initial=0.0))


def same_message(one: Cloud | None, other: Cloud | None, exact: bool = True) -> bool:
    """Tell whether two clouds are the same in every byte; not ``exact``: float64 coordinates apart."""
    if one is None or other is None:
        return one is other
    facts = [
        (c.topic, c.channel, c.encoding, c.delay, c.sequence, c.head, c.tail, c.loose, c.whole)
        for c in (one, other)
    ]
    if facts[0] != facts[1] or one.rest.shape != other.rest.shape:
        return False
    layout = one.layout
    matters = np.ones(layout.point_step, np.bool_)
    for field in layout.xyz:
        matters[field.at] = exact
    columns = matters[layout.rest]
    return bool((one.rest[:, columns] == other.rest[:, columns]).all())


def intensity_of(cloud: Cloud) -> NDArray[np.float32]:
    """Intensities ``(N,)`` of a cloud that holds them itself, rounded to float32; zeros where it has none."""
    field = cloud.layout.intensity
    column = next((c for c in cloud.layout.columns if field is not None and c.offset == field.offset), None)
    if field is None or column is None or column.datatype != field.datatype:
        return np.zeros(len(cloud.rest), np.float32)
    with np.errstate(over="ignore", invalid="ignore"):
        return cloud.values(column).astype(np.float32)


def times_of(cloud: Cloud) -> NDArray[np.int64] | None:
    """Times ``(N,)`` of the points of a cloud, in whole steps from some origin that differs from cloud to cloud; None where it tells none."""
    field = cloud.time_field
    if field is None or len(cloud.rest) == 0:
        return None
    spans = spans_of(cloud.values(field))
    return None if spans is None else spans.low


def _float32(rows: Bytes, field: Field, layout: Layout) -> NDArray[np.float32]:
    """Values of a field as float32; float32 bit for bit, NaN included."""
    kind = np.dtype("u4") if field.datatype == 7 else field.dtype
    raw = np.ascontiguousarray(rows[:, field.at])
    values = raw.view(kind.newbyteorder(">" if layout.big_endian else "<"))[:, 0]
    if field.datatype == 7:
        return values.astype(np.uint32).view(np.float32)
    with np.errstate(over="ignore", invalid="ignore"):
        return values.astype(np.float32)
