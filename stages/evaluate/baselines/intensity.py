"""Intensity as small integers, for the codecs that carry an integer attribute.

KITTI's intensities are ``float32(n / 100)``, so the integer is n and costs no table. Other values get a table
of the distinct float32 values in front.
"""

from __future__ import annotations

import struct

import numpy as np
from numpy.typing import NDArray

from salpcc.stages.evaluate.baselines.baseline import NotPossible

_HUNDREDTHS = (np.arange(256) / 100).astype(np.float32)


def to_levels(intensity: NDArray[np.float32]) -> tuple[bytes, NDArray[np.uint16]]:
    """Return a table (empty for hundredths) and the level of each value ``(N,)``.

    Raises:
        NotPossible: more than 65,535 distinct values.
    """
    levels = np.clip(np.nan_to_num(np.rint(intensity.astype(np.float64) * 100)), 0, 255).astype(np.uint16)
    if np.array_equal(_HUNDREDTHS[levels].view(np.uint32), intensity.view(np.uint32)):
        return struct.pack("<H", 0), levels
    bits, index = np.unique(intensity.view(np.uint32), return_inverse=True)
    if len(bits) > 0xFFFF:
        raise NotPossible("more than 65,535 distinct intensities")
    return struct.pack("<H", len(bits)) + bits.tobytes(), index.astype(np.uint16)


def from_levels(data: bytes, levels: NDArray[np.integer]) -> NDArray[np.float32]:
    """Return the intensities of levels, given data that starts with the table of :func:`to_levels`."""
    size = table_size(data)
    values = _HUNDREDTHS if size == 2 else np.frombuffer(data[2:size], np.float32)
    return np.take(values, levels)


def table_size(data: bytes) -> int:
    """Return how many bytes the table takes at the start of ``data``."""
    (count,) = struct.unpack_from("<H", data)
    return 2 + 4 * int(count)
