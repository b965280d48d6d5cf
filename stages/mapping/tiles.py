"""Cut a map into square tiles: which boxes touch which tiles, and the entries of one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]


@dataclass(frozen=True, order=True)
class Tile:
    """The square from ``(x, y) * size`` to ``(x + 1, y + 1) * size`` metres, of any height."""

    x: int
    y: int

    @property
    def name(self) -> str:
        """Name of its files, such as ``x+003_y-001``."""
        return f"x{self.x:+04d}_y{self.y:+04d}"

    @classmethod
    def named(cls, name: str) -> Tile:
        """Return the tile of a name; inverse of :attr:`name`."""
        x, y = (int(part[1:]) for part in name.split("_"))
        return cls(x, y)

    def corner(self, size: float) -> F64:
        """Return its lower corner ``(3,)`` at height 0."""
        return np.array([self.x * size, self.y * size, 0.0])

    def holds(self, xyz: F64, size: float) -> NDArray[np.bool_]:
        """Mark the points ``(N, 3)`` that lie in it."""
        at = np.floor(xyz[:, :2] / size)
        return np.asarray((at[:, 0] == self.x) & (at[:, 1] == self.y))

    def distance(self, place: F64, size: float) -> float:
        """Return how far a place ``(3,)`` lies from it, seen from above; 0 inside."""
        low = self.corner(size)[:2]
        off = np.maximum(np.maximum(low - place[:2], place[:2] - low - size), 0.0)
        return float(np.hypot(off[0], off[1]))


@dataclass(frozen=True)
class Box:
    """A box along the axes: two corners, metres."""

    low: tuple[float, float, float]
    high: tuple[float, float, float]

    @classmethod
    def of(cls, numbers: Sequence[float]) -> Box:
        """Return the box of six numbers x0, y0, z0, x1, y1, z1."""
        x0, y0, z0, x1, y1, z1 = map(float, numbers)
        return cls((x0, y0, z0), (x1, y1, z1))

    @property
    def numbers(self) -> tuple[float, ...]:
        """Its six numbers; inverse of :meth:`of`."""
        return *self.low, *self.high

    @classmethod
    def around(cls, xyz: F64) -> Box:
        """Return the box around at least one point ``(N, 3)``."""
        low, high = xyz.min(axis=0), xyz.max(axis=0)
        return cls(
            (float(low[0]), float(low[1]), float(low[2])), (float(high[0]), float(high[1]), float(high[2]))
        )

    def moved(self, by: Sequence[float]) -> Box:
        """Return it moved by a way ``(3,)``."""
        return Box.of([*np.add(self.low, by), *np.add(self.high, by)])

    def holds(self, xyz: F64) -> NDArray[np.bool_]:
        """Mark the points ``(N, 3)`` that lie in it, the lower border included, the upper not."""
        return np.asarray(((xyz >= self.low) & (xyz < self.high)).all(axis=1))

    def distance(self, places: F64) -> F64:
        """Return how far each of places ``(N, 3)`` lies from it; 0 inside."""
        off = np.maximum(np.maximum(np.array(self.low) - places, places - np.array(self.high)), 0.0)
        return np.asarray(np.linalg.norm(off, axis=1))

    def touches(self, tile: Tile, size: float) -> bool:
        """Tell whether anything of it lies in a tile."""
        at = (tile.x, tile.y)
        return all(self.low[i] < (at[i] + 1) * size and self.high[i] > at[i] * size for i in range(2))

    def tiles(self, size: float) -> set[Tile]:
        """Return the tiles that the box touches."""
        (x0, y0), (x1, y1) = (
            (int(np.floor(c / size)) for c in corner[:2]) for corner in (self.low, self.high)
        )
        return {Tile(x, y) for x in range(x0, x1 + 1) for y in range(y0, y1 + 1)}


def blocks_of(xyz: F64, size: float) -> list[tuple[Tile, NDArray[np.intp]]]:
    """Part points ``(N, 3)`` by the tiles of their own frame: each with the indices of its points, ascending."""
    if not len(xyz):
        return []
    at = np.floor(xyz[:, :2] / size).astype(np.int64)
    number = at[:, 0] * (1 << 32) + at[:, 1]
    order = np.argsort(number, kind="stable")
    parts = np.split(order, np.flatnonzero(np.diff(number[order])) + 1)
    return [(Tile(int(at[part[0], 0]), int(at[part[0], 1])), part) for part in parts]
