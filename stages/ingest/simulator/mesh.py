"""Build triangle meshes out of simple solids; every triangle knows its material, label and brightness."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

F64 = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles with attributes.

    Attributes:
        vertices: ``(V, 3)`` float64 metres.
        triangles: ``(T, 3)`` int64 indices of vertices.
        material: ``(T,)`` uint8 index into :data:`~.materials.MATERIALS`.
        label: ``(T,)`` uint32 SemanticKITTI label, instance in the upper 16 bits.
        gain: ``(T,)`` float64 brightness of the object relative to its material.
    """

    vertices: F64
    triangles: NDArray[np.int64]
    material: NDArray[np.uint8]
    label: NDArray[np.uint32]
    gain: F64

    def moved(self, shift: ArrayLike, yaw: float = 0.0, scale: ArrayLike = 1.0) -> Mesh:
        """Scale, then turn about z by ``yaw`` rad, then shift by metres."""
        v = self.vertices * np.asarray(scale, np.float64)
        c, s = np.cos(yaw), np.sin(yaw)
        turned = np.stack([c * v[:, 0] - s * v[:, 1], s * v[:, 0] + c * v[:, 1], v[:, 2]], axis=1)
        return replace(self, vertices=turned + np.asarray(shift, np.float64))

    def brightened(self, gain: float) -> Mesh:
        """Multiply the brightness of every triangle."""
        return replace(self, gain=self.gain * gain)

    def labelled(self, label: int, instance: int = 0) -> Mesh:
        """Give every triangle one label and instance."""
        return replace(self, label=np.full_like(self.label, label | instance << 16))


Shape = Callable[..., Mesh]  # shapes a thing with a random generator
Kinds = tuple[tuple[Shape, float], ...]  # of things, and the share of each


def drawn(kinds: Kinds, rng: np.random.Generator) -> Shape:
    """Draw a kind of thing by the shares, which add up to 1."""
    return kinds[int(rng.choice(len(kinds), p=[share for _, share in kinds]))][0]


def surface(vertices: ArrayLike, triangles: ArrayLike, material: int, label: int, gain: float = 1.0) -> Mesh:
    """Make a mesh of one material and label."""
    v = np.asarray(vertices, np.float64).reshape(-1, 3)
    t = np.asarray(triangles, np.int64).reshape(-1, 3)
    n = len(t)
    return Mesh(v, t, np.full(n, material, np.uint8), np.full(n, label, np.uint32), np.full(n, gain))


def merge(parts: Iterable[Mesh]) -> Mesh:
    """Join meshes into one."""
    parts = list(parts)
    offsets = np.concatenate([[0], np.cumsum([len(p.vertices) for p in parts])])
    return Mesh(
        np.concatenate([p.vertices for p in parts]),
        np.concatenate([p.triangles + o for p, o in zip(parts, offsets, strict=False)]),
        np.concatenate([p.material for p in parts]),
        np.concatenate([p.label for p in parts]),
        np.concatenate([p.gain for p in parts]),
    )


def box(low: Sequence[float], high: Sequence[float], material: int, label: int, gain: float = 1.0) -> Mesh:
    """Make an axis-aligned box between two corners."""
    corners = np.array([[(low, high)[i >> a & 1][a] for a in range(3)] for i in range(8)])
    faces = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    return surface(
        corners, [t for a, b, c, d in faces for t in ((a, b, c), (a, c, d))], material, label, gain
    )


def sheet(corners: ArrayLike, material: int, label: int, gain: float = 1.0) -> Mesh:
    """Make a flat quadrilateral of four corners in order."""
    return surface(corners, [(0, 1, 2), (0, 2, 3)], material, label, gain)


def grid(points: F64, material: NDArray[np.uint8], label: NDArray[np.uint32]) -> Mesh:
    """Make a height field of ``points (R, C, 3)`` with one material and label per cell ``(R-1, C-1)``."""
    rows, cols = points.shape[:2]
    index = np.arange(rows * cols).reshape(rows, cols)
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    triangles = np.stack([np.stack([a, b, c], -1), np.stack([a, c, d], -1)], axis=2).reshape(-1, 3)
    twice = (np.repeat(material.ravel(), 2), np.repeat(label.ravel(), 2))
    return Mesh(points.reshape(-1, 3), triangles, *twice, np.ones(len(triangles)))


def tube(
    foot: ArrayLike,
    top: ArrayLike,
    radii: tuple[float, float],
    material: int,
    label: int,
    sides: int = 8,
    capped: bool = True,
    gain: float = 1.0,
) -> Mesh:
    """Make a (tapered) cylinder from ``foot`` to ``top``."""
    a, b = np.asarray(foot, np.float64), np.asarray(top, np.float64)
    axis = (b - a) / np.linalg.norm(b - a)
    u = np.cross(axis, [1.0, 0, 0] if abs(axis[0]) < 0.8 else [0, 1.0, 0])
    u /= np.linalg.norm(u)
    w = np.cross(axis, u)
    angle = np.arange(sides) * 2 * np.pi / sides
    ring = np.cos(angle)[:, None] * u + np.sin(angle)[:, None] * w
    vertices = np.concatenate([a + radii[0] * ring, b + radii[1] * ring, [a, b]])
    i, j = np.arange(sides), (np.arange(sides) + 1) % sides
    triangles = [np.stack([i, j, j + sides], 1), np.stack([i, j + sides, i + sides], 1)]
    if capped:
        end = np.full(sides, 2 * sides)
        triangles += [np.stack([j, i, end], 1), np.stack([i + sides, j + sides, end + 1], 1)]
    return surface(vertices, np.concatenate(triangles), material, label, gain)


def ellipsoid(centre: ArrayLike, radii: ArrayLike, material: int, label: int, gain: float = 1.0) -> Mesh:
    """Make an ellipsoid of 8 x 5 facets."""
    lon = np.arange(8) * np.pi / 4
    lat = np.linspace(-np.pi / 2, np.pi / 2, 6)
    unit = np.stack(
        [
            np.outer(np.cos(lat), np.cos(lon)),
            np.outer(np.cos(lat), np.sin(lon)),
            np.repeat(np.sin(lat)[:, None], 8, 1),
        ],
        axis=-1,
    )
    i = np.arange(40).reshape(5, 8)
    right = np.roll(i, -1, axis=1)
    triangles = np.stack(
        [np.stack([i, right, right + 8], -1), np.stack([i, right + 8, i + 8], -1)], 2
    ).reshape(-1, 3)
    vertices = unit.reshape(-1, 3) * np.asarray(radii, np.float64) + np.asarray(centre, np.float64)
    return surface(vertices, triangles, material, label, gain)


def extrude(
    profile: ArrayLike, width: tuple[F64, F64] | float, material: int, label: int, gain: float = 1.0
) -> Mesh:
    """Extrude a convex-ish side profile ``(K, 2)`` of (x, z) across y.

    ``width`` is one width, or (left, right) y per profile point, so that a cabin can lean inwards.
    """
    p = np.asarray(profile, np.float64)
    n = len(p)
    left, right = width if isinstance(width, tuple) else (np.full(n, width / 2), np.full(n, -width / 2))
    vertices = np.concatenate([np.stack([p[:, 0], y, p[:, 1]], 1) for y in (left, right)])
    hub = np.stack([vertices[:n].mean(0), vertices[n:].mean(0)])
    i, j = np.arange(n), (np.arange(n) + 1) % n
    around = [np.stack([i, j, j + n], 1), np.stack([i, j + n, i + n], 1)]
    sides = [np.stack([j, i, np.full(n, 2 * n)], 1), np.stack([i + n, j + n, np.full(n, 2 * n + 1)], 1)]
    return surface(np.concatenate([vertices, hub]), np.concatenate(around + sides), material, label, gain)


def flakes(
    centres: F64, size: ArrayLike, material: int, label: int, rng: np.random.Generator, gain: float = 1.0
) -> Mesh:
    """Make one small triangle of random attitude per centre ``(K, 3)``: leaves, grass, clutter."""
    n = len(centres)
    edges = (
        rng.normal(size=(n, 3, 3)) * np.broadcast_to(np.asarray(size, np.float64), (n,))[:, None, None] * 0.6
    )
    vertices = (centres[:, None] + edges).reshape(-1, 3)
    return surface(vertices, np.arange(3 * n), material, label, gain)
