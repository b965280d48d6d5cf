"""PC-PNG of the paper: the scan as a 64 x 2000 range image, eq. (1), in 16-bit PNG.

The grid is uniform and the sensor is not, so directions are off by up to half a cell, and points that fall
into one cell leave one; the asked error steers the range step only. That is the baseline's nature.
"""

from __future__ import annotations

import struct

import numpy as np
from numpy.typing import NDArray

from salpcc.stages.evaluate.baselines.contract import Baseline, NotPossible, Points, Promise, step_of

ROWS, COLUMNS = 64, 2000
UP, DOWN = np.deg2rad(2.0), np.deg2rad(-24.9)  # the sensor's field of view, 26.9 degrees
_HEAD = struct.Struct("<d")


def project(points: Points, step: float) -> NDArray[np.uint16]:
    """Return the range image, levels of ``step``; 0 is empty, the nearest point of a cell stays.

    Raises:
        NotPossible: a range does not fit 16 bits at this step.
    """
    x, y, z = points[:, :3].astype(np.float64).T
    reach = np.sqrt(x * x + y * y + z * z)
    level = np.rint(reach / step)
    if not np.isfinite(level).all() or level.max(initial=0) > 0xFFFF:
        raise NotPossible(f"a range beyond {0xFFFF * step:.0f} m does not fit 16 bits at this step")
    level, x, y, z, reach = (a[level > 0] for a in (level, x, y, z, reach))
    row = np.clip((UP - np.arcsin(z / reach)) / (UP - DOWN) * ROWS, 0, ROWS - 1).astype(int)
    column = ((1 - np.arctan2(y, x) / np.pi) / 2 * COLUMNS).astype(int) % COLUMNS
    image = np.zeros((ROWS, COLUMNS), np.uint16)
    order = np.argsort(-reach, kind="stable")
    image[row[order], column[order]] = level[order]
    return image


def unproject(image: NDArray[np.uint16], step: float) -> Points:
    """Return the points ``(M, 3)`` at the centres of the filled cells, row by row."""
    row, column = np.nonzero(image)
    reach = image[row, column] * step
    elevation = UP - (row + 0.5) / ROWS * (UP - DOWN)
    azimuth = (1 - 2 * (column + 0.5) / COLUMNS) * np.pi
    flat = reach * np.cos(elevation)
    points = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), reach * np.sin(elevation)], axis=1)
    return points.astype(np.float32)


def encode(points: Points, max_error: float) -> bytes:
    """Encode the range image; see the contract."""
    import imagecodecs

    step = step_of(max_error)
    return _HEAD.pack(step) + bytes(imagecodecs.png_encode(project(points, step), level=9))


def decode(data: bytes) -> Points:
    """Decode the range image to points."""
    import imagecodecs

    (step,) = _HEAD.unpack_from(data)
    return unproject(np.asarray(imagecodecs.png_decode(data[_HEAD.size :])), float(step))


PNG = Baseline(
    title="PC-PNG",
    packages=("imagecodecs",),
    promise=Promise(bound="none", order=False, count=False, intensity=False),
    encode=encode,
    decode=decode,
)
