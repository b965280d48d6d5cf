"""Cloudini by ``pureini``, which writes and reads its format: quantised differences, then Zstandard.

The package is under the GPL and so no part of any install here; the row appears where somebody installed it. Geometry
only: the format quantises intensity, or codes its float bits at 18 bits a point.
"""

from __future__ import annotations

import numpy as np

from salpcc.stages.evaluate.baselines.baseline import Baseline, NotPossible, Points, Promise, step_of


def encode(points: Points, max_error: float) -> bytes:
    """Encode x, y and z in steps of twice the asked error; the message says how."""
    import pureini

    places = np.ascontiguousarray(points[:, :3])
    if not np.isfinite(places).all():
        raise NotPossible("points that are not finite cannot be quantised")
    step = step_of(max_error)
    fields = [
        pureini.PointField(axis, 4 * i, pureini.FieldType.FLOAT32, step) for i, axis in enumerate("xyz")
    ]
    info = pureini.EncodingInfo(
        fields,
        width=len(places),
        point_step=12,
        encoding_opt=pureini.EncodingOptions.LOSSY,
        compression_opt=pureini.CompressionOption.ZSTD,
    )
    return bytes(pureini.PointcloudEncoder(info).encode(places.tobytes()))


def decode(data: bytes) -> Points:
    """Decode to the points in their order."""
    import pureini

    plain, _ = pureini.PointcloudDecoder().decode(data)
    return np.frombuffer(plain, np.float32).reshape(-1, 3).copy()


CLOUDINI = Baseline(
    title="Cloudini",
    packages=("pureini",),
    promise=Promise(bound="axis", order=True, count=True, intensity=False),
    encode=encode,
    decode=decode,
)
