"""Shape plants: trees with trunk and leaves, hedges, bushes, far thickets.

Leaves are small triangles, so that beams pass through gaps and hit at scattered depths.
"""

from __future__ import annotations

import numpy as np

from salpcc.stages.ingest.simulator.materials import NAMES
from salpcc.stages.ingest.simulator.mesh import F64, Mesh, box, ellipsoid, flakes, merge, tube

LEAF, BARK = NAMES["leaf"], NAMES["bark"]
VEGETATION, TRUNK = 70, 71


def _in_ball(n: int, rng: np.random.Generator, hollow: float = 0.5) -> F64:
    """Draw ``n`` points of the unit ball, denser towards its skin."""
    v = rng.normal(size=(n, 3))
    v /= np.linalg.norm(v, axis=1, keepdims=True)
    return np.asarray(v * rng.uniform(hollow, 1.0, (n, 1)))


def tree(rng: np.random.Generator) -> Mesh:
    """Shape a broad-leaved tree of 5 to 12 m: trunk, some branches, a crown of several clumps."""
    height = float(rng.uniform(5.0, 12.0))
    bole = float(rng.uniform(1.1, 2.6))
    radius = float(rng.uniform(0.06, 0.2))
    lean = rng.normal(0, 0.15, 2)
    crown = float(rng.uniform(1.4, 3.0))
    fork = np.array([lean[0], lean[1], bole + 0.6])
    parts = [tube((0, 0, -0.3), fork, (radius * 1.15, radius * 0.8), BARK, TRUNK, 8)]
    for _ in range(int(rng.integers(5, 9))):
        level = float(rng.uniform(bole + 0.5, height))
        spread = crown * np.sin(np.pi * np.clip((level - bole) / (height - bole + 0.6), 0.15, 0.9))
        angle = float(rng.uniform(0, 2 * np.pi))
        centre = np.array(
            [lean[0] + 0.6 * spread * np.cos(angle), lean[1] + 0.6 * spread * np.sin(angle), level]
        )
        size = np.array([1, 1, 0.75]) * spread * float(rng.uniform(0.55, 0.9))
        leaves = int(np.clip(450 * size[0] ** 2, 100, 1500))
        parts.append(flakes(_in_ball(leaves, rng) * size + centre, 0.19, LEAF, VEGETATION, rng))
        parts.append(tube(fork, centre, (radius * 0.5, 0.03), BARK, VEGETATION, 4, False))
    return merge(parts).brightened(float(rng.uniform(0.85, 1.15)))


def bush(rng: np.random.Generator, size: float = 1.0) -> Mesh:
    """Shape a bush about ``size`` metres in radius."""
    leaves = int(260 * size * size) + 60
    core = ellipsoid((0, 0, size * 0.5), (size * 0.6, size * 0.6, size * 0.6), LEAF, VEGETATION, 0.9)
    centres = _in_ball(leaves, rng, 0.3) * np.array([size, size, size * 0.8]) + (0, 0, size * 0.6)
    return merge([core, flakes(centres, 0.13, LEAF, VEGETATION, rng)]).brightened(
        float(rng.uniform(0.8, 1.2))
    )


def hedge(length: float, height: float, thick: float, rng: np.random.Generator) -> Mesh:
    """Shape a hedge along +x: leaves about a dense block."""
    n = int(length * (2 * height + thick) * 110)
    centres = rng.uniform((0, -thick / 2, 0), (length, thick / 2, height), (n, 3))
    skin = rng.random(n) < 0.7
    centres[skin, 1] = np.where(rng.random(int(skin.sum())) < 0.5, -thick / 2, thick / 2)
    centres[:, 1:] += rng.normal(0, 0.05, (n, 2))
    inner = thick / 2 - 0.15
    core = box((0, -inner, 0), (length, inner, height - 0.12), LEAF, VEGETATION, 0.9)
    return merge([core, flakes(centres, 0.1, LEAF, VEGETATION, rng)]).brightened(float(rng.uniform(0.8, 1.1)))


def thicket(length: float, height: float, depth: float, rng: np.random.Generator) -> Mesh:
    """Shape a far wood along +x out of large leaves, ``depth`` metres deep."""
    n = int(length * height * 36)
    centres = rng.uniform((0, 0, 0), (length, depth, 1.0), (n, 3))
    roof = height * (0.75 + 0.25 * np.sin(centres[:, 0] * rng.uniform(0.2, 0.5) + rng.uniform(0, 6)))
    centres[:, 2] *= roof
    return flakes(centres, 0.42, LEAF, VEGETATION, rng)
