"""Sun et al., the intra part: range image, clusters, prediction inside a cluster, residual.

The scan becomes the uniform range image; neighbouring cells whose ranges differ by less than a threshold belong
to one cluster; the contours say where clusters end, and inside one each cell is predicted from its decoded
neighbours. The published coder also predicts between registered scans; this one sees single scans. Chosen
here, as not stated: a threshold of 0.3 m, the mean of the left and the upper neighbour as prediction, contours
as two bits a cell, xz for contours and residuals. The cell grid bounds no 3-D error, as with PC-PNG.
"""

from __future__ import annotations

import lzma
import struct
from itertools import pairwise

import numpy as np
from numba import njit

from salpcc.stages.evaluate.baselines.contract import Baseline, Points, Promise, step_of
from salpcc.stages.evaluate.baselines.range_image import COLUMNS, ROWS, project, to_levels, unproject

_THRESHOLD = 0.3  # metres
_HEAD = struct.Struct("<dII")  # step; bytes of the contours, of the residuals
_FILTERS = [{"id": lzma.FILTER_LZMA2, "preset": 6}]


def encode(points: Points, max_error: float) -> bytes:
    """Encode the range image; see the contract."""
    step = step_of(max_error)
    levels = to_levels(project(points), step).astype(np.int64)
    filled = levels > 0
    near = _THRESHOLD / step
    left, upper = np.zeros_like(filled), np.zeros_like(filled)
    left[:, 1:] = filled[:, 1:] & filled[:, :-1] & (np.abs(np.diff(levels, axis=1)) < near)
    upper[1:] = filled[1:] & filled[:-1] & (np.abs(np.diff(levels, axis=0)) < near)
    residual = _residuals(levels, left, upper)[filled]
    folded = ((residual << 1) ^ (residual >> 63)).astype("<u4")
    streams = [
        b"".join(np.packbits(bits).tobytes() for bits in (filled, left, upper)),
        folded.view(np.uint8).reshape(-1, 4).T.tobytes(),
    ]
    packed = [lzma.compress(stream, lzma.FORMAT_RAW, filters=_FILTERS) for stream in streams]
    return _HEAD.pack(step, *map(len, packed)) + b"".join(packed)


def decode(data: bytes) -> Points:
    """Decode to the points at the centres of the filled cells."""
    step, *sizes = _HEAD.unpack_from(data)
    ends = np.cumsum([_HEAD.size, *sizes]).tolist()
    contours, residuals = (
        lzma.decompress(data[start:end], lzma.FORMAT_RAW, filters=_FILTERS) for start, end in pairwise(ends)
    )
    bits = np.unpackbits(np.frombuffer(contours, np.uint8)).astype(bool)
    filled, left, upper = bits.reshape(3, ROWS, COLUMNS)
    planes = np.frombuffer(residuals, np.uint8).reshape(4, -1)
    folded = np.ascontiguousarray(planes.T).view("<u4").ravel().astype(np.int64)
    residual = np.zeros((ROWS, COLUMNS), np.int64)
    residual[filled] = (folded >> 1) ^ -(folded & 1)
    return unproject(_levels(residual, left, upper) * float(step))


@njit(cache=True)
def _predicted(levels, left, upper, i, j):  # type: ignore[no-untyped-def]
    """Mean of the neighbours in the same cluster that are decoded already; 0 where a cluster starts."""
    if left[i, j] and upper[i, j]:
        return (levels[i, j - 1] + levels[i - 1, j]) >> 1
    if left[i, j]:
        return levels[i, j - 1]
    return levels[i - 1, j] if upper[i, j] else 0


@njit(cache=True)
def _residuals(levels, left, upper):  # type: ignore[no-untyped-def]
    residual = np.empty_like(levels)
    for i in range(levels.shape[0]):
        for j in range(levels.shape[1]):
            residual[i, j] = levels[i, j] - _predicted(levels, left, upper, i, j)
    return residual


@njit(cache=True)
def _levels(residual, left, upper):  # type: ignore[no-untyped-def]
    """Inverse of :func:`_residuals`."""
    levels = np.empty_like(residual)
    for i in range(levels.shape[0]):
        for j in range(levels.shape[1]):
            levels[i, j] = residual[i, j] + _predicted(levels, left, upper, i, j)
    return levels


SUN = Baseline(
    title="Sun et al., intra part",
    packages=(),
    promise=Promise(bound="none", order=False, count=False, intensity=False),
    encode=encode,
    decode=decode,
)
