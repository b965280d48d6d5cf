"""Feng, Liu and Zhu 2020: planes over tiles of the range image, shared between registered scans.

The scan becomes the range image of PC-PNG; in each row of 4 x 4 tiles a plane is fitted to a tile and carried on
over the next tiles for as long as every range in them stays within the asked error of the plane's; tiles
that no plane fits keep their ranges. Of five scans the middle one is the key: the others are moved onto it,
seen from where it was, and a tile in which the key's plane holds takes that plane for one bit.

Chosen here, as not stated or not known to us: motions by point-to-plane ICP, six float32 each; planes in inverse
range, where they are linear (``1/r = n . u``), in one least-squares step; at most 255 tiles a plane; only the
key's planes are shared; unfit ranges in steps of twice the error; xz for all streams. The cell grid bounds no
3-D error, as with PC-PNG, and moved scans lose more points to shared cells.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from salpcc.stages.evaluate.baselines.baseline import Baseline, Group, Points, Promise, step_of
from salpcc.stages.evaluate.baselines.packing import pack_streams, unpack_streams
from salpcc.stages.evaluate.baselines.rigid import STILL, Motion, move, move_back, register
from salpcc.stages.evaluate.baselines.tile_image import (
    COLUMNS,
    ROWS,
    directions,
    project,
    to_levels,
    unproject,
)
from salpcc.stages.evaluate.baselines.tile_planes import TILE, draw, fit, inherit, of_cells, planes_of_tiles

_GROUP = 5
_TILES = (ROWS // TILE, COLUMNS // TILE)
_HEAD = struct.Struct("<d6f")  # step, motion onto the key


@dataclass(frozen=True)
class Key:
    """What other scans take from the key: its planes ``(P, 3)``, and which of them each tile has."""

    planes: NDArray[np.float32]
    of_tile: NDArray[np.int64]


_NO_KEY = Key(np.zeros((0, 3), np.float32), np.full(_TILES, -1))


def encode_group(scans: Sequence[Points], max_error: float) -> list[bytes]:
    """Encode up to five scans; the data of the middle one decode alone."""
    middle = len(scans) // 2
    parts = {middle: _encode(scans[middle], max_error, STILL, _NO_KEY)}
    key = _key(parts[middle])
    for order in (range(middle - 1, -1, -1), range(middle + 1, len(scans))):
        motion = STILL
        for number in order:
            motion = register(scans[number][:, :3], scans[middle][:, :3], motion)
            moved = move(scans[number][:, :3], motion).astype(np.float32)
            parts[number] = _encode(moved, max_error, motion, key)
    return [parts[number] for number in range(len(scans))]


def decode_group(parts: Sequence[bytes]) -> list[Points]:
    """Decode to the points at the centres of the filled cells, moved back to their own scan."""
    middle = len(parts) // 2
    key = _key(parts[middle])
    return [_decode(part, _NO_KEY if i == middle else key) for i, part in enumerate(parts)]


def _encode(points: Points, max_error: float, motion: Motion, key: Key) -> bytes:
    step = step_of(max_error)
    ranges = project(points)
    taken = inherit(ranges, directions(), key.planes, key.of_tile, max_error)
    rest = np.where(of_cells(taken), 0.0, ranges)
    runs, planes, fitted = fit(rest, directions(), max_error)
    levels = to_levels(rest[(rest > 0) & ~fitted], step)
    return pack_streams(
        _HEAD.pack(step, *motion),
        np.packbits(ranges > 0).tobytes() + np.packbits(taken).tobytes(),
        runs.tobytes(),
        planes.T.tobytes(),
        levels.view(np.uint8).reshape(-1, 2).T.tobytes(),
    )


def _decode(data: bytes, key: Key) -> Points:
    step, *motion = _HEAD.unpack_from(data)
    masks, runs, planes, levels = unpack_streams(data, _HEAD.size, 4)
    bits = np.unpackbits(np.frombuffer(masks, np.uint8)).astype(bool)
    filled = bits[: ROWS * COLUMNS].reshape(ROWS, COLUMNS)
    taken = of_cells(bits[filled.size :].reshape(_TILES))
    rest = filled & ~taken
    ranges, fitted = draw(rest, np.frombuffer(runs, np.uint8), _columns(planes), directions())
    low, high = np.frombuffer(levels, np.uint8).reshape(2, -1).astype(np.uint16)
    ranges[rest & ~fitted] = (low | (high << 8)) * step
    shared = filled & taken
    normals = key.planes[of_cells(key.of_tile)[shared]].astype(np.float64)
    ranges[shared] = 1.0 / (normals * directions()[shared]).sum(axis=1)
    points = unproject(ranges)
    moved = np.array(motion, np.float32)
    return move_back(points, moved).astype(np.float32) if moved.any() else points


def _key(data: bytes) -> Key:
    """Read the planes of the key."""
    _, runs, planes, _ = unpack_streams(data, _HEAD.size, 4)
    return Key(_columns(planes), planes_of_tiles(np.frombuffer(runs, np.uint8), *_TILES))


def _columns(planes: bytes) -> NDArray[np.float32]:
    return np.ascontiguousarray(np.frombuffer(planes, np.float32).reshape(3, -1).T)


FENG = Baseline(
    title="Feng et al. 2020",
    packages=(),
    promise=Promise(bound="none", order=False, count=False, intensity=False),
    encode=lambda points, max_error: encode_group([points], max_error)[0],
    decode=lambda data: decode_group([data])[0],
    group=Group(_GROUP, encode_group, decode_group),
)
