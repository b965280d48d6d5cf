"""LASzip by laspy and lazrs: LAS point format 0 with a scale of twice the asked error."""

from __future__ import annotations

import io

import numpy as np

from salpcc.stages.evaluate.baselines.baseline import (
    Baseline,
    NotPossible,
    Points,
    Promise,
    dequantize,
    quantize,
    step_of,
)
from salpcc.stages.evaluate.baselines.intensity import from_levels, table_size, to_levels


def encode(points: Points, max_error: float) -> bytes:
    """Write a .laz file; one byte with the number of columns and the intensity table stand in front."""
    import laspy

    step = step_of(max_error)
    levels = quantize(points[:, :3], step)
    if len(levels) and np.abs(levels).max() >= 2**31:
        raise NotPossible("a coordinate does not fit 32 bits at this step")
    header = laspy.LasHeader(point_format=0, version="1.2")
    header.scales, header.offsets = np.full(3, step), np.zeros(3)
    las = laspy.LasData(header)
    las.X, las.Y, las.Z = levels.astype(np.int32).T
    head = b""
    if points.shape[1] == 4:
        head, las.intensity = to_levels(np.ascontiguousarray(points[:, 3]))
    buffer = io.BytesIO()
    las.write(buffer, do_compress=True, laz_backend=laspy.LazBackend.Lazrs)
    return bytes([points.shape[1]]) + head + buffer.getvalue()


def decode(data: bytes) -> Points:
    """Read the .laz file back."""
    import laspy

    columns, rest = data[0], data[1:]
    start = table_size(rest) if columns == 4 else 0
    las = laspy.read(io.BytesIO(rest[start:]), laz_backend=laspy.LazBackend.Lazrs)
    points = dequantize(np.column_stack([las.X, las.Y, las.Z]), float(las.header.scales[0]))
    if columns == 3:
        return points
    return np.column_stack([points, from_levels(rest, np.asarray(las.intensity))])


LASZIP = Baseline(
    title="LASzip",
    packages=("laspy", "lazrs"),
    promise=Promise(bound="axis", order=True, count=True, intensity=True),
    encode=encode,
    decode=decode,
)
