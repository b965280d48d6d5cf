"""PC-PNG of the paper: the scan as a uniform range image in 16-bit PNG. The error steers the range step only."""

from __future__ import annotations

import struct

import numpy as np

from salpcc.stages.evaluate.baselines.baseline import Baseline, Points, Promise, step_of
from salpcc.stages.evaluate.baselines.tile_image import project, to_levels, unproject

_HEAD = struct.Struct("<d")


def encode(points: Points, max_error: float) -> bytes:
    """Encode the range image; see the contract."""
    import imagecodecs

    step = step_of(max_error)
    return _HEAD.pack(step) + bytes(imagecodecs.png_encode(to_levels(project(points), step), level=9))


def decode(data: bytes) -> Points:
    """Decode the range image to points."""
    import imagecodecs

    (step,) = _HEAD.unpack_from(data)
    return unproject(np.asarray(imagecodecs.png_decode(data[_HEAD.size :])) * float(step))


PNG = Baseline(
    title="PC-PNG",
    packages=("imagecodecs",),
    promise=Promise(bound="none", order=False, count=False, intensity=False),
    encode=encode,
    decode=decode,
)
