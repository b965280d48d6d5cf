"""Shape people: on foot, on a bicycle, on a motorcycle. They look along +x and stand on z = 0."""

from __future__ import annotations

import numpy as np

from salpcc.stages.ingest.simulator.materials import NAMES
from salpcc.stages.ingest.simulator.mesh import Mesh, ellipsoid, merge, tube
from salpcc.stages.ingest.simulator.vehicles import bicycle, motorcycle

CLOTH, SKIN = NAMES["cloth"], NAMES["skin"]
PERSON, BICYCLIST, MOTORCYCLIST = 30, 31, 32


def person(rng: np.random.Generator, label: int = PERSON) -> Mesh:
    """Shape a walker in mid stride, 1.2 to 1.95 m tall."""
    stride, swing = float(rng.uniform(0.05, 0.4)), float(rng.uniform(-0.3, 0.3))
    top, legs = float(rng.uniform(0.6, 1.3)), float(rng.uniform(0.5, 1.2))
    parts = [
        tube((stride, 0.1, 0), (0, 0.09, 0.88), (0.06, 0.095), CLOTH, label, 6, gain=legs),
        tube((-stride, -0.1, 0), (0, -0.09, 0.88), (0.06, 0.095), CLOTH, label, 6, gain=legs),
        ellipsoid((0, 0, 1.15), (0.15, 0.22, 0.36), CLOTH, label, top),
        tube((-swing, 0.27, 0.85), (0, 0.23, 1.4), (0.045, 0.06), CLOTH, label, 5, gain=top),
        tube((swing, -0.27, 0.85), (0, -0.23, 1.4), (0.045, 0.06), CLOTH, label, 5, gain=top),
        ellipsoid((0.02, 0, 1.62), (0.11, 0.09, 0.14), SKIN, label),
    ]
    if rng.random() < 0.3:
        parts.append(
            ellipsoid((-0.2, 0, 1.2), (0.13, 0.17, 0.24), CLOTH, label, float(rng.uniform(0.4, 1.4)))
        )
    height = float(rng.normal(0.99, 0.06) if rng.random() < 0.9 else rng.uniform(0.7, 0.85))
    wide = float(rng.uniform(0.9, 1.2))
    return merge(parts).moved((0, 0, 0), 0.0, (wide, wide, height))


def _rider(rng: np.random.Generator, label: int, seat: float) -> list[Mesh]:
    top, legs = float(rng.uniform(0.6, 1.3)), float(rng.uniform(0.5, 1.2))
    return [
        tube((-0.15, 0, seat), (0.12, 0, seat + 0.55), (0.16, 0.19), CLOTH, label, 7, gain=top),
        ellipsoid((0.2, 0, seat + 0.75), (0.11, 0.1, 0.14), SKIN, label),
        *[
            part
            for side in (1, -1)
            for part in (
                tube((0.1, side * 0.19, seat + 0.5), (0.38, side * 0.25, 1.05), (0.055, 0.045), CLOTH, label, 5, gain=top),
                tube((-0.12, side * 0.1, seat), (0.16, side * 0.12, 0.65), (0.085, 0.065), CLOTH, label, 5, gain=legs),
                tube((0.16, side * 0.12, 0.65), (-0.05 + side * 0.12, side * 0.12, 0.2), (0.06, 0.05), CLOTH, label, 5, gain=legs),
            )
        ],
    ]  # fmt: skip


def bicyclist(rng: np.random.Generator, label: int = BICYCLIST) -> Mesh:
    """Shape a rider on a bicycle; both carry the rider's label, as in SemanticKITTI."""
    return merge([bicycle(rng, label), *_rider(rng, label, 0.92)])


def motorcyclist(rng: np.random.Generator, label: int = MOTORCYCLIST) -> Mesh:
    """Shape a rider on a motorcycle; both carry the rider's label."""
    return merge([motorcycle(rng, label), *_rider(rng, label, 0.82)])
