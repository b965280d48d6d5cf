"""Feng, Liu and Zhu 2020, the spatial part: planes over tiles of the range image.

The scan becomes the range image of PC-PNG; in each row of 4 x 4 tiles a plane is fitted to a tile and carried on
over the next tiles for as long as every range in them stays within the asked error of the plane's; tiles
that no plane fits keep their ranges. The published coder also shares planes over five registered scans; this
one sees single scans. Chosen here, as not stated: planes are fitted in inverse range, where they are linear
(``1/r = n . u``), in one least-squares step; at most 255 tiles a plane; unfit ranges in steps of twice the
error; xz for all streams. The cell grid bounds no 3-D error, as with PC-PNG.
"""

from __future__ import annotations

import lzma
import struct
from itertools import pairwise

import numpy as np
from numba import njit

from salpcc.stages.evaluate.baselines.contract import Baseline, Points, Promise, step_of
from salpcc.stages.evaluate.baselines.range_image import (
    COLUMNS,
    ROWS,
    directions,
    project,
    to_levels,
    unproject,
)

TILE = 4
_LONGEST = 255
_HEAD = struct.Struct("<dIIII")  # step; bytes of: mask, run lengths, planes, unfit levels
_FILTERS = [{"id": lzma.FILTER_LZMA2, "preset": 6}]


def encode(points: Points, max_error: float) -> bytes:
    """Encode the range image; see the contract."""
    step = step_of(max_error)
    ranges = project(points)
    runs, planes, fitted = _fit(ranges, directions(), max_error)
    levels = to_levels(ranges[(ranges > 0) & ~fitted], step)
    streams = [
        np.packbits(ranges > 0).tobytes(),
        runs.tobytes(),
        planes.T.tobytes(),
        levels.view(np.uint8).reshape(-1, 2).T.tobytes(),
    ]
    packed = [lzma.compress(stream, lzma.FORMAT_RAW, filters=_FILTERS) for stream in streams]
    return _HEAD.pack(step, *map(len, packed)) + b"".join(packed)


def decode(data: bytes) -> Points:
    """Decode to the points at the centres of the filled cells."""
    step, *sizes = _HEAD.unpack_from(data)
    ends = np.cumsum([_HEAD.size, *sizes])
    plain = [
        lzma.decompress(data[start:end], lzma.FORMAT_RAW, filters=_FILTERS)
        for start, end in pairwise(ends.tolist())
    ]
    filled = np.unpackbits(np.frombuffer(plain[0], np.uint8), count=ROWS * COLUMNS).reshape(ROWS, COLUMNS) > 0
    runs = np.frombuffer(plain[1], np.uint8)
    planes = np.ascontiguousarray(np.frombuffer(plain[2], np.float32).reshape(3, -1).T)
    low, high = np.frombuffer(plain[3], np.uint8).reshape(2, -1).astype(np.uint16)
    ranges, fitted = _draw(filled, runs, planes, directions())
    ranges[filled & ~fitted] = (low | (high << 8)) * step
    return unproject(ranges)


@njit(cache=True)
def _fit(ranges, rays, bound):  # type: ignore[no-untyped-def]
    """Cover each row of tiles with runs: a length of 0 is one unfit tile, else that many tiles on a plane.

    Returns run lengths (K,) uint8, planes (P, 3) float32 in the order of their runs, and the mask of cells
    that a plane gives back within ``bound`` metres.
    """
    tiles = ranges.shape[1] // TILE
    runs = np.zeros(ranges.shape[0] // TILE * tiles, np.uint8)
    planes = np.zeros((len(runs), 3), np.float32)
    fitted = np.zeros(ranges.shape, np.bool_)
    n_runs, n_planes = 0, 0
    for row in range(0, ranges.shape[0], TILE):
        tile = 0
        while tile < tiles:
            normal, vector = np.zeros((3, 3)), np.zeros(3)
            best = np.zeros(3, np.float32)
            length = 0
            while tile + length < tiles and length < _LONGEST:
                first = (tile + length) * TILE
                for i in range(row, row + TILE):
                    for j in range(first, first + TILE):
                        if ranges[i, j] > 0:
                            weight = ranges[i, j] ** 4  # an error of 1/r counts r^2 times as much in r
                            for a in range(3):
                                vector[a] += weight * rays[i, j, a] / ranges[i, j]
                                for b in range(3):
                                    normal[a, b] += weight * rays[i, j, a] * rays[i, j, b]
                steady = (1e-9 * np.trace(normal) + 1e-9) * np.eye(3)  # a line of points has many planes
                plane = np.linalg.solve(normal + steady, vector).astype(np.float32)
                if not _within(ranges, rays, plane, row, tile * TILE, first + TILE, bound):
                    break
                best, length = plane, length + 1
            if length:
                planes[n_planes] = best
                n_planes += 1
                fitted[row : row + TILE, tile * TILE : (tile + length) * TILE] = True
            runs[n_runs] = length
            n_runs += 1
            tile += max(length, 1)
    return runs[:n_runs], planes[:n_planes], fitted


@njit(cache=True)
def _within(ranges, rays, plane, row, start, end, bound):  # type: ignore[no-untyped-def]
    """Tell whether a plane gives every filled cell of columns start:end back within the bound."""
    for i in range(row, row + TILE):
        for j in range(start, end):
            if ranges[i, j] > 0:
                inverse = plane[0] * rays[i, j, 0] + plane[1] * rays[i, j, 1] + plane[2] * rays[i, j, 2]
                if inverse <= 0 or abs(1.0 / inverse - ranges[i, j]) > bound:
                    return False
    return True


@njit(cache=True)
def _draw(filled, runs, planes, rays):  # type: ignore[no-untyped-def]
    """Draw the planes; inverse of :func:`_fit`. Returns ranges and the mask of cells that have a plane."""
    ranges, fitted = np.zeros(filled.shape), np.zeros(filled.shape, np.bool_)
    tiles = filled.shape[1] // TILE
    run, plane, row, tile = 0, 0, 0, 0
    while row < filled.shape[0]:
        length = int(runs[run])
        run += 1
        for i in range(row, row + TILE):
            for j in range(tile * TILE, (tile + length) * TILE):
                fitted[i, j] = True
                if filled[i, j]:
                    n, u = planes[plane], rays[i, j]
                    ranges[i, j] = 1.0 / (n[0] * u[0] + n[1] * u[1] + n[2] * u[2])
        plane += 1 if length else 0
        tile += max(length, 1)
        if tile >= tiles:
            row, tile = row + TILE, 0
    return ranges, fitted


FENG = Baseline(
    title="Feng et al. 2020, spatial part",
    packages=(),
    promise=Promise(bound="none", order=False, count=False, intensity=False),
    encode=encode,
    decode=decode,
)
