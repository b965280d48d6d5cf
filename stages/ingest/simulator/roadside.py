"""Shape what stands beside the road and may pass for a vehicle: walls, garages, guard rails, hoardings, large signs.

Each stands on z = 0 with its middle at x = y = 0 along +x, as those of :mod:`.vehicles` do.
"""

from __future__ import annotations

import numpy as np

from salpcc.stages.ingest.simulator.mesh import Kinds, Mesh, box, drawn, extrude, merge
from salpcc.stages.ingest.simulator.structures import (
    BUILDING,
    FENCE,
    METAL,
    PLASTER,
    SIGN,
    TARPAULIN,
    TRAFFIC_SIGN,
    WINDOW,
    WOOD,
)


def wall(rng: np.random.Generator) -> Mesh:
    """Shape a wall, with pillars or without, of any height between a garden's and a noise barrier's."""
    half, high, thick = (
        float(rng.uniform(1.5, 9.0)),
        float(rng.uniform(0.6, 4.5)),
        float(rng.uniform(0.1, 0.3)),
    )
    material = (PLASTER, PLASTER, WOOD, METAL)[int(rng.integers(4))]
    gain = float(rng.uniform(0.6, 1.3))
    parts = [box((-half, -thick, -0.5), (half, thick, high), material, FENCE, gain)]
    if rng.random() < 0.5:
        every, out = float(rng.uniform(1.5, 4.0)), thick + float(rng.uniform(0.05, 0.2))
        parts += [box((x, -out, -0.5), (x + 0.3, out, high + 0.1), material, FENCE, gain) for x in np.arange(-half, half, every)]  # fmt: skip
    return merge(parts)


def garage(rng: np.random.Generator) -> Mesh:
    """Shape a garage, a kiosk, a shed or the corner of a house: as large as a lorry, but it stands on the ground."""
    half, deep, high = (
        float(rng.uniform(1.2, 6.0)),
        float(rng.uniform(1.2, 3.5)),
        float(rng.uniform(2.0, 4.3)),
    )
    gain = float(rng.uniform(0.6, 1.3))
    material = PLASTER if rng.random() < 0.7 else WOOD
    parts = [box((-half, -deep, -0.5), (half, deep, high), material, BUILDING, gain)]
    if rng.random() < 0.4:
        eaves = [(-deep - 0.2, high), (0.0, high + float(rng.uniform(0.4, 1.5))), (deep + 0.2, high)]
        parts.append(
            extrude(eaves, 2 * half + 0.3, PLASTER, BUILDING, gain * 0.8).moved((0, 0, 0), np.pi / 2)
        )
    for x in np.arange(-half + 0.4, half - 1.0, float(rng.uniform(1.5, 3.0))):
        foot = float(rng.choice([0.02, 0.9]))
        glass = WINDOW if foot > 0.5 else WOOD
        parts += [
            box((x, side * deep - 0.02, foot), (x + 0.9, side * deep + 0.02, 1.9), glass, BUILDING, gain)
            for side in (-1, 1)
        ]
    return merge(parts)


def guard_rail(rng: np.random.Generator) -> Mesh:
    """Shape a guard rail: a beam or two on posts, or a low barrier of concrete."""
    half, gain = float(rng.uniform(3.0, 10.0)), float(rng.uniform(0.5, 1.5))
    if rng.random() < 0.25:
        side = [(-0.3, -0.3), (-0.3, 0.1), (-0.1, 0.35), (-0.08, 0.85), (0.08, 0.85), (0.1, 0.35), (0.3, 0.1), (0.3, -0.3)]  # fmt: skip
        return extrude(side, 2 * half, PLASTER, FENCE, gain).moved((0, 0, 0), np.pi / 2)
    low = float(rng.uniform(0.45, 0.65))
    parts = [box((-half, -0.06, z), (half, 0.02, z + 0.3), METAL, FENCE, gain) for z in ((low,) if rng.random() < 0.7 else (low - 0.3, low + 0.25))]  # fmt: skip
    parts += [box((x, -0.02, -0.3), (x + 0.1, 0.08, low + 0.3), METAL, FENCE, gain) for x in np.arange(-half, half, float(rng.uniform(1.3, 4.0)))]  # fmt: skip
    return merge(parts)


def hoarding(rng: np.random.Generator) -> Mesh:
    """Shape a hoarding or a sheet on a scaffold, on legs or down to the ground."""
    half, top, foot = (
        float(rng.uniform(1.2, 5.0)),
        float(rng.uniform(2.2, 4.3)),
        float(rng.choice([0.0, 0.5, 1.0])),
    )
    gain = float(rng.uniform(0.5, 1.4))
    parts = [box((-half, -0.06, foot), (half, 0.06, top), TARPAULIN, FENCE, gain)]
    parts += [
        box((x, -0.1, -0.3), (x + 0.12, 0.12, top), METAL, FENCE, gain) for x in np.arange(-half, half, 1.9)
    ]
    return merge(parts)


def large_sign(rng: np.random.Generator) -> Mesh:
    """Shape a direction sign on two posts, across the road."""
    half, low = float(rng.uniform(0.6, 2.5)), float(rng.uniform(0.8, 2.4))
    high, gain = low + float(rng.uniform(0.6, 2.5)), float(rng.uniform(0.6, 1.5))
    parts = [box((-0.04, -half, low), (0.04, half, high), SIGN, TRAFFIC_SIGN, gain)]
    parts += [box((0.04, y - 0.07, -0.3), (0.16, y + 0.07, high), METAL, TRAFFIC_SIGN) for y in (-0.7 * half, 0.7 * half)]  # fmt: skip
    return merge(parts)


_KINDS: Kinds = (
    (wall, 0.35),
    (garage, 0.25),
    (guard_rail, 0.2),
    (hoarding, 0.1),
    (large_sign, 0.1),
)


def roadside_thing(rng: np.random.Generator) -> Mesh:
    """Shape one, of a kind drawn at random."""
    return drawn(_KINDS, rng)(rng)
