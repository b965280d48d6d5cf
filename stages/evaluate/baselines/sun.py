"""Sun et al.: range image, clusters, prediction inside a cluster or from the registered scan before, residual.

The scan becomes the uniform range image; neighbouring cells whose ranges differ by less than a threshold belong
to one cluster; the contours say where clusters end, and inside one each cell is predicted from its decoded
neighbours. From the second scan of a group on, the decoded scan before is moved by the registered motion and
projected again, and each block of cells says by one bit whether that predicts it better.

Chosen here, as not stated or not known to us: a threshold of 0.3 m, the mean of the left and the upper neighbour as
prediction, contours as two bits a cell, motion by point-to-plane ICP, blocks of 4 x 16 cells instead of whole
clusters, groups of eight scans, xz for all streams. The cell grid bounds no 3-D error, as with PC-PNG.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.evaluate.baselines.baseline import Baseline, Group, Points, Promise, step_of
from salpcc.stages.evaluate.baselines.packing import pack_streams, unpack_streams
from salpcc.stages.evaluate.baselines.rigid import STILL, Motion, move_back, register
from salpcc.stages.evaluate.baselines.tile_image import COLUMNS, ROWS, project, to_levels, unproject

_THRESHOLD = 0.3  # metres
_GROUP = 8
_BLOCK = (4, 16)
_BLOCKS = (ROWS // _BLOCK[0], COLUMNS // _BLOCK[1])
_HEAD = struct.Struct("<d6f")  # step, motion onto the scan before
_NOTHING = np.zeros((ROWS, COLUMNS), np.int64)

Levels = NDArray[np.int64]
Mask = NDArray[np.bool_]


def encode_group(scans: Sequence[Points], max_error: float) -> list[bytes]:
    """Encode consecutive scans; each but the first needs the one before."""
    step = step_of(max_error)
    parts: list[bytes] = []
    motion, before = STILL, _NOTHING
    for number, points in enumerate(scans):
        if number:
            motion = register(points[:, :3], scans[number - 1][:, :3], motion)
        levels = to_levels(project(points), step).astype(np.int64)
        parts.append(_encode(levels, step, motion, _seen_again(before, step, motion)))
        before = levels
    return parts


def decode_group(parts: Sequence[bytes]) -> list[Points]:
    """Decode to the points at the centres of the filled cells."""
    clouds = []
    levels = _NOTHING
    for part in parts:
        step, *motion = _HEAD.unpack_from(part)
        levels = _decode(part, _seen_again(levels, step, np.array(motion, np.float32)))
        clouds.append(unproject(levels * float(step)))
    return clouds


def _seen_again(levels: Levels, step: float, motion: Motion) -> Levels:
    """Levels ``(64, 2000)`` that the scan before would have from the place of this one; 0 where it saw nothing."""
    if not levels.any():
        return _NOTHING
    moved = move_back(unproject(levels * float(step)), motion).astype(np.float32)
    return to_levels(np.minimum(project(moved), 0xFFFF * step), step).astype(np.int64)


def _encode(levels: Levels, step: float, motion: Motion, guess: Levels) -> bytes:
    filled = levels > 0
    near = _THRESHOLD / step
    left, upper = np.zeros_like(filled), np.zeros_like(filled)
    left[:, 1:] = filled[:, 1:] & filled[:, :-1] & (np.abs(np.diff(levels, axis=1)) < near)
    upper[1:] = filled[1:] & filled[:-1] & (np.abs(np.diff(levels, axis=0)) < near)
    nobody = np.zeros_like(filled)
    cost = [
        np.where(filled, np.log2(1.0 + np.abs(_residuals(levels, left, upper, guess, mode))), 0.0)
        for mode in (nobody, ~nobody)
    ]
    better = _per_block(cost[1]) < _per_block(cost[0])
    inter = _of_cells(better)
    left, upper = left & ~inter, upper & ~inter
    residual = _residuals(levels, left, upper, guess, inter)[filled]
    folded = ((residual << 1) ^ (residual >> 63)).astype("<u4")
    return pack_streams(
        _HEAD.pack(step, *motion),
        b"".join(np.packbits(bits).tobytes() for bits in (filled, left, upper)),
        np.packbits(better).tobytes(),
        folded.view(np.uint8).reshape(-1, 4).T.tobytes(),
    )


def _decode(data: bytes, guess: Levels) -> Levels:
    contours, blocks, residuals = unpack_streams(data, _HEAD.size, 3)
    bits = np.unpackbits(np.frombuffer(contours, np.uint8)).astype(bool)
    filled, left, upper = bits.reshape(3, ROWS, COLUMNS)
    count = _BLOCKS[0] * _BLOCKS[1]
    better = np.unpackbits(np.frombuffer(blocks, np.uint8), count=count).astype(bool).reshape(_BLOCKS)
    planes = np.frombuffer(residuals, np.uint8).reshape(4, -1)
    folded = np.ascontiguousarray(planes.T).view("<u4").ravel().astype(np.int64)
    residual = np.zeros((ROWS, COLUMNS), np.int64)
    residual[filled] = (folded >> 1) ^ -(folded & 1)
    levels: Levels = _levels(residual, filled, left, upper, guess, _of_cells(better))
    return levels


def _per_block(cost: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(cost.reshape(_BLOCKS[0], _BLOCK[0], _BLOCKS[1], _BLOCK[1]).sum(axis=(1, 3)))


def _of_cells(blocks: Mask) -> Mask:
    return np.repeat(np.repeat(blocks, _BLOCK[0], axis=0), _BLOCK[1], axis=1)


@njit(cache=True)
def _predicted(levels: Levels, left: Mask, upper: Mask, guess: Levels, inter: Mask, i: int, j: int) -> int:
    """The registered scan before, or the mean of the decoded neighbours in the cluster; 0 where it starts."""
    if inter[i, j]:
        return guess[i, j]
    if left[i, j] and upper[i, j]:
        return (levels[i, j - 1] + levels[i - 1, j]) >> 1
    if left[i, j]:
        return levels[i, j - 1]
    return levels[i - 1, j] if upper[i, j] else 0


@njit(cache=True)
def _residuals(levels: Levels, left: Mask, upper: Mask, guess: Levels, inter: Mask) -> Levels:
    residual = np.empty_like(levels)
    for i in range(levels.shape[0]):
        for j in range(levels.shape[1]):
            residual[i, j] = levels[i, j] - _predicted(levels, left, upper, guess, inter, i, j)
    return residual


@njit(cache=True)
def _levels(residual: Levels, filled: Mask, left: Mask, upper: Mask, guess: Levels, inter: Mask) -> Levels:
    """Inverse of :func:`_residuals`; empty cells are 0."""
    levels = np.zeros_like(residual)
    for i in range(levels.shape[0]):
        for j in range(levels.shape[1]):
            if filled[i, j]:
                levels[i, j] = residual[i, j] + _predicted(levels, left, upper, guess, inter, i, j)
    return levels


SUN = Baseline(
    title="Sun et al.",
    packages=(),
    promise=Promise(bound="none", order=False, count=False, intensity=False),
    encode=lambda points, max_error: encode_group([points], max_error)[0],
    decode=lambda data: decode_group([data])[0],
    group=Group(_GROUP, encode_group, decode_group),
)
