"""Octree coding after the Point Cloud Library, in its voxel-grid mode: points in one voxel become one.

The cloud is cut into voxels of twice the asked error; each inner node of the tree over them is one byte that
says which of its eight children exist, and the bytes, level by level, are range coded with static
frequencies. The order of the points and points that share a voxel are lost.
"""

from __future__ import annotations

import struct

import numpy as np
from numpy.typing import NDArray

from salpcc.stages.evaluate.baselines.baseline import (
    Baseline,
    NotPossible,
    Points,
    Promise,
    dequantize,
    quantize,
    step_of,
)
from salpcc.stages.evaluate.baselines.static_range_coder import decode_bytes, encode_bytes

_HEAD = struct.Struct("<dqqqB")  # step, origin in steps, depth
_MAX_DEPTH = 21


def encode(points: Points, max_error: float) -> bytes:
    """Encode the occupied voxels; see the contract."""
    step = step_of(max_error)
    voxels = quantize(points[:, :3], step)
    if not len(voxels):
        return _HEAD.pack(step, 0, 0, 0, 0)
    origin = voxels.min(axis=0)
    depth = max(1, int((voxels - origin).max()).bit_length())
    if depth > _MAX_DEPTH:
        raise NotPossible(f"a tree of {depth} levels; {_MAX_DEPTH} fit")
    codes = np.unique(interleave((voxels - origin).astype(np.uint64)))
    levels = []
    for _ in range(depth):
        child, codes = codes & np.uint64(7), codes >> np.uint64(3)
        first = np.flatnonzero(np.r_[True, codes[1:] != codes[:-1]])
        levels.append(np.bitwise_or.reduceat((1 << child).astype(np.uint8), first))
        codes = codes[first]
    return _HEAD.pack(step, *map(int, origin), depth) + encode_bytes(np.concatenate(levels[::-1]))


def decode(data: bytes) -> Points:
    """Return the voxels' centres ``(M, 3)``, in the order of their Morton codes."""
    step, *origin, depth = _HEAD.unpack_from(data)
    if not depth:
        return np.empty((0, 3), np.float32)
    occupancy = decode_bytes(data[_HEAD.size :])
    codes, start = np.zeros(1, np.uint64), 0
    for _ in range(depth):
        children = np.unpackbits(occupancy[start : start + len(codes), None], axis=1, bitorder="little")
        start += len(codes)
        parent, child = np.nonzero(children)
        codes = (codes[parent] << np.uint64(3)) | child.astype(np.uint64)
    return dequantize(separate(codes).astype(np.int64) + np.array(origin), step)


def interleave(cells: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Morton codes ``(N,)`` of cells ``(N, 3)`` below 2^21; x has the highest bit of each three."""
    codes = np.zeros(len(cells), np.uint64)
    for axis in range(3):
        codes |= _spread(cells[:, axis]) << np.uint64(2 - axis)
    return codes


def separate(codes: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Cells ``(N, 3)`` of Morton codes; inverse of :func:`interleave`."""
    return np.stack([_gather(codes >> np.uint64(2 - axis)) for axis in range(3)], axis=1)


# Steps of the well-known bit tricks: after (or before) each shift only the masked bits are kept.
_STEPS = (
    (32, 0x001F00000000FFFF),
    (16, 0x001F0000FF0000FF),
    (8, 0x100F00F00F00F00F),
    (4, 0x10C30C30C30C30C3),
    (2, 0x1249249249249249),
)


def _spread(values: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Put two zero bits between the bits of 21-bit values."""
    for shift, mask in _STEPS:
        values = (values | (values << np.uint64(shift))) & np.uint64(mask)
    return values


def _gather(values: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Take every third bit; inverse of :func:`_spread`."""
    masks = [0x1FFFFF, *(mask for _, mask in _STEPS)]
    values = values & np.uint64(masks[-1])
    for (shift, _), mask in zip(reversed(_STEPS), masks[-2::-1], strict=True):
        values = (values | (values >> np.uint64(shift))) & np.uint64(mask)
    return values


OCTREE = Baseline(
    title="Octree (PCL's scheme, voxel grid)",
    packages=(),
    promise=Promise(bound="axis", order=False, count=False, intensity=False),
    encode=encode,
    decode=decode,
)
