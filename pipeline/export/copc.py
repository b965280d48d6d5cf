"""COPC: a LAZ 1.4 file whose points lie by the nodes of an octree, so that a viewer reads only what it shows (copc.io, version 1.0).

A node holds a point for each of its 128 x 128 x 128 cells at most, and its eight children what that leaves. Each is a chunk of LAZ
of its own; where they lie is in an extended record at the end of the file. What knows LAZ only reads it as that.
"""

from __future__ import annotations

import io
import struct
from typing import TYPE_CHECKING, BinaryIO

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import laspy

F64 = NDArray[np.float64]

_CELLS = 128  # of a node, along each axis
_DEEPEST = 10  # what is left there stays there
# Numbers of the specification: the info record is the first after the header of 375 bytes.
_INFO = struct.Struct("<5d2Q2d88x")
_ENTRY = np.dtype([("key", "<i4", 4), ("offset", "<u8"), ("size", "<i4"), ("points", "<i4")])
_EXTENDED = struct.Struct("<H16sHQ32s")
_TABLE_PLACE = 8  # bytes before the first chunk: where the table of chunks lies


def copc_of(las: laspy.LasData) -> bytes:
    """Return the file of points of format 6 to 8, at least one."""
    import lazrs
    from laspy.vlrs.known import LasZipVlr
    from laspy.vlrs.vlr import VLR

    xyz = np.array(las.xyz)
    low, high = xyz.min(axis=0), xyz.max(axis=0)
    half = max(float((high - low).max()) / 2, 1e-3)
    middle = low + half  # readers take the lower corner of the header for that of the cube
    nodes, order, starts = _octree(xyz, low, 2 * half)
    records = las.points.array[order]

    header = las.header
    header.partial_reset()
    header.grow(las.points)
    coder = lazrs.LazVlr.new_for_compression(
        header.point_format.id, header.point_format.num_extra_bytes, True
    )
    header.set_compressed(True)
    header.vlrs.insert(0, VLR("copc", 1, "COPC info", bytes(_INFO.size)))
    header.vlrs.append(LasZipVlr(coder.record_data()))
    stream = io.BytesIO()
    header.write_to(stream)
    compressor = lazrs.LasZipCompressor(stream, coder)
    compressor.compress_chunks([part.tobytes() for part in np.split(records, starts[1:])])
    compressor.done()

    table = np.array(_chunk_sizes(stream, header.offset_to_point_data, coder), np.int64)
    entries = np.zeros(len(nodes), _ENTRY)
    entries["key"], entries["size"] = nodes, table[: len(nodes)]
    entries["points"] = np.diff(np.append(starts, len(records)))
    entries["offset"] = (
        header.offset_to_point_data + _TABLE_PLACE + np.cumsum(table[: len(nodes)]) - entries["size"]
    )
    stream.seek(0, 2)
    header.start_of_first_evlr, header.number_of_evlrs = stream.tell(), 1
    stream.write(_EXTENDED.pack(0, b"copc", 1000, entries.nbytes, b"EPT hierarchy"))
    place = stream.tell()
    stream.write(entries.tobytes())
    info = _INFO.pack(*middle, half, 2 * half / _CELLS, place, entries.nbytes, *_times(las))
    header.vlrs[0] = VLR("copc", 1, "COPC info", info)
    stream.seek(0)
    header.write_to(stream, ensure_same_size=True)
    return stream.getvalue()


def _octree(xyz: F64, low: F64, side: float) -> tuple[NDArray[np.int32], NDArray[np.intp], NDArray[np.intp]]:
    """Part points ``(N, 3)`` by nodes of an octree over a cube.

    Returns:
        Keys ``(K, 4)`` of the nodes (level, x, y, z), the points ``(N,)`` in the order of nodes, and where each node's begin.
    """
    level = np.full(len(xyz), _DEEPEST, np.int32)
    left = np.arange(len(xyz))
    for depth in range(_DEEPEST):
        first = np.unique(_numbers(xyz[left], low, side, _CELLS << depth), return_index=True)[1]
        level[left[first]] = depth
        left = np.delete(left, first)
    at = np.minimum(_cells(xyz, low, side / (1 << level)[:, None]), (1 << level)[:, None] - 1)
    keys = np.column_stack([level, at]).astype(np.int32)
    order = np.lexsort(keys.T[::-1])
    new = np.append(True, (np.diff(keys[order], axis=0) != 0).any(axis=1))
    starts = np.flatnonzero(new)
    return keys[order[starts]], order, starts


def _cells(xyz: F64, low: F64, size: F64 | float) -> NDArray[np.int64]:
    return np.asarray(np.floor((xyz - low) / size).astype(np.int64))


def _numbers(xyz: F64, low: F64, side: float, cells: int) -> NDArray[np.int64]:
    """Number the cells of points, ``cells`` along an axis of the cube; neighbours in z differ by 1."""
    at = np.minimum(_cells(xyz, low, side / cells), cells - 1)  # what lies on the upper faces is of the last
    return np.asarray((at[:, 0] * cells + at[:, 1]) * cells + at[:, 2])


def _chunk_sizes(stream: BinaryIO, offset_to_points: int, coder: object) -> list[int]:
    import lazrs

    stream.seek(offset_to_points)
    return [size for _, size in lazrs.read_chunk_table(stream, coder)]


def _times(las: laspy.LasData) -> tuple[float, float]:
    times = np.array(las.gps_time)
    return float(times.min()), float(times.max())
