"""Google Draco, kd-tree (loses the order) and sequential (keeps it).

The quantisation origin and range are given explicitly, so that the step is exactly twice the asked error;
left to itself Draco takes the scan's extent, and the error depends on the farthest point.
"""

from __future__ import annotations

import numpy as np

from salpcc.stages.evaluate.baselines.baseline import Baseline, NotPossible, Points, Promise, step_of
from salpcc.stages.evaluate.baselines.intensity import from_levels, table_size, to_levels

_LEVEL = 7  # of 0 to 10; 8 to 10 give no smaller point clouds
_MAX_BITS = 30


def _encode(points: Points, max_error: float, keep_order: bool) -> bytes:
    """Encode; one byte says how many columns, then the intensity table where there is one."""
    import DracoPy

    step = step_of(max_error)
    places = np.ascontiguousarray(points[:, :3])
    if not len(places) or not np.isfinite(places).all():
        raise NotPossible("Draco takes finite points only, and at least one")
    origin = np.floor(places.min(axis=0).astype(np.float64) / step) * step
    levels = int(np.ceil((places.max(axis=0) - origin).max() / step)) + 1
    bits = max(1, int(levels).bit_length())
    if bits > _MAX_BITS:
        raise NotPossible(f"{bits} bits a coordinate; Draco has {_MAX_BITS}")
    head, attributes = b"", {}
    if points.shape[1] == 4:
        head, intensity = to_levels(np.ascontiguousarray(points[:, 3]))
        kind = np.uint8 if intensity.max() < 256 else np.uint16
        attributes = {0: np.ascontiguousarray(intensity[:, None].astype(kind))}
    data = DracoPy.encode(
        places,
        quantization_bits=bits,
        quantization_range=step * (2**bits - 1),
        quantization_origin=origin.astype(np.float32),
        compression_level=_LEVEL,
        preserve_order=keep_order,
        generic_attributes=attributes or None,
    )
    return bytes([points.shape[1]]) + head + bytes(data)


def decode(data: bytes) -> Points:
    """Decode either kind; the stream says which it is."""
    import DracoPy

    columns, rest = data[0], data[1:]
    start = table_size(rest) if columns == 4 else 0
    cloud = DracoPy.decode(rest[start:])
    points = np.asarray(cloud.points, np.float32)
    if columns == 3:
        return points
    levels = np.asarray(cloud.get_attribute_by_unique_id(0)["data"]).ravel()
    return np.column_stack([points, from_levels(rest, levels)])


DRACO = Baseline(
    title="Draco, kd-tree",
    packages=("DracoPy",),
    promise=Promise(bound="axis", order=False, count=True, intensity=True),
    encode=lambda points, max_error: _encode(points, max_error, keep_order=False),
    decode=decode,
)
DRACO_SEQUENTIAL = Baseline(
    title="Draco, sequential",
    packages=("DracoPy",),
    promise=Promise(bound="axis", order=True, count=True, intensity=True),
    encode=lambda points, max_error: _encode(points, max_error, keep_order=True),
    decode=decode,
)
