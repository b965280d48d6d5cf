"""Planes over runs of 4 x 4 tiles of a range image: the kernels of Feng's coder.

A plane is ``(3,)`` float32 n with ``1/r = n . u`` along the unit vector u; in inverse range it is linear.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

TILE = 4
_LONGEST = 255


@njit(cache=True)
def fit(
    ranges: NDArray[np.float64], rays: NDArray[np.float64], bound: float
) -> tuple[NDArray[np.uint8], NDArray[np.float32], NDArray[np.bool_]]:
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
def _within(
    ranges: NDArray[np.float64],
    rays: NDArray[np.float64],
    plane: NDArray[np.float32],
    row: int,
    start: int,
    end: int,
    bound: float,
) -> bool:
    """Tell whether a plane gives every filled cell of columns start:end back within the bound."""
    for i in range(row, row + TILE):
        for j in range(start, end):
            if ranges[i, j] > 0:
                inverse = plane[0] * rays[i, j, 0] + plane[1] * rays[i, j, 1] + plane[2] * rays[i, j, 2]
                if inverse <= 0 or abs(1.0 / inverse - ranges[i, j]) > bound:
                    return False
    return True


@njit(cache=True)
def draw(
    filled: NDArray[np.bool_], runs: NDArray[np.uint8], planes: NDArray[np.float32], rays: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Draw the planes; inverse of :func:`fit`. Returns ranges and the mask of cells that have a plane."""
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


@njit(cache=True)
def inherit(
    ranges: NDArray[np.float64],
    rays: NDArray[np.float64],
    planes: NDArray[np.float32],
    of_tile: NDArray[np.int64],
    bound: float,
) -> NDArray[np.bool_]:
    """Mark the tiles whose cells another image's plane of the same tile gives back; empty tiles are not marked."""
    taken = np.zeros(of_tile.shape, np.bool_)
    for row in range(of_tile.shape[0]):
        for tile in range(of_tile.shape[1]):
            if of_tile[row, tile] < 0:
                continue
            i, j = row * TILE, tile * TILE
            if np.any(ranges[i : i + TILE, j : j + TILE] > 0):
                plane = planes[of_tile[row, tile]]
                taken[row, tile] = _within(ranges, rays, plane, i, j, j + TILE, bound)
    return taken


@njit(cache=True)
def planes_of_tiles(runs: NDArray[np.uint8], rows: int, tiles: int) -> NDArray[np.int64]:
    """Which plane ``(rows, tiles)`` each tile has, -1 for none, from the run lengths."""
    of_tile = np.full((rows, tiles), -1, np.int64)
    row, tile, plane = 0, 0, 0
    for length in runs:
        if length:
            of_tile[row, tile : tile + length] = plane
            plane += 1
        tile += int(length) if length else 1
        if tile >= tiles:
            row, tile = row + 1, 0
    return of_tile


def of_cells(tiles: NDArray[Any]) -> NDArray[Any]:
    """Spread a value of each tile over its cells."""
    return np.repeat(np.repeat(tiles, TILE, axis=0), TILE, axis=1)
