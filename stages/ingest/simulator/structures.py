"""Shape what is built: houses, fences, walls, poles, lamps, signs, bins."""

from __future__ import annotations

import numpy as np

from salpcc.stages.ingest.simulator.materials import NAMES
from salpcc.stages.ingest.simulator.mesh import Mesh, box, extrude, merge, sheet, surface, tube

PLASTER, WINDOW, WOOD = NAMES["plaster"], NAMES["window"], NAMES["wood"]
METAL, SIGN, TARPAULIN = NAMES["metal"], NAMES["sign"], NAMES["tarpaulin"]
BUILDING, FENCE, POLE, TRAFFIC_SIGN, OTHER_OBJECT = 50, 51, 80, 81, 99


def house(length: float, depth: float, rng: np.random.Generator, storeys: int = 2) -> Mesh:
    """Shape a house along +x with its front on y = 0 and its body at y > 0: windows, gable roof, relief."""
    high = storeys * 2.9 + float(rng.uniform(0.0, 0.8))
    gain = float(rng.uniform(0.75, 1.25))
    parts = [box((0, 0, -1.0), (length, depth, high), PLASTER, BUILDING, gain)]
    step = float(rng.uniform(2.2, 3.4))
    for storey in range(storeys):
        sill = storey * 2.9 + 0.9
        for x in np.arange(step * 0.5, length - 1.2, step):
            wide = float(rng.uniform(0.9, 1.5))
            door = storey == 0 and rng.random() < 0.15
            foot = 0.05 if door else sill
            front = [
                (x, -0.02, foot),
                (x + wide, -0.02, foot),
                (x + wide, -0.02, sill + 1.3),
                (x, -0.02, sill + 1.3),
            ]
            parts.append(sheet(front, WOOD if door else WINDOW, BUILDING, gain))
            parts.append(
                box((x - 0.05, -0.14, sill - 0.1), (x + wide + 0.05, 0, sill), PLASTER, BUILDING, gain)
            )
    for x in rng.uniform(1, max(length - 3, 1.1), int(rng.integers(0, 3))):
        low = float(rng.choice([-1.0, 2.6]))
        out = -float(rng.uniform(0.6, 1.3))
        parts.append(box((x, out, low), (x + 2.2, 0, min(low + 3.5, high)), PLASTER, BUILDING, gain))
    ridge = high + float(rng.uniform(1.5, 3.5))
    eaves = [(-0.4, high), (depth / 2, ridge), (depth + 0.4, high)]
    roof = extrude(eaves, length + 0.6, PLASTER, BUILDING, gain * 0.8).moved((0, 0, 0), np.pi / 2)
    parts.append(roof.moved((length / 2, 0, 0)))
    return merge(parts)


def fence(length: float, height: float, rng: np.random.Generator, slatted: bool) -> Mesh:
    """Shape a fence along +x: upright slats with gaps, or a solid wall."""
    gain = float(rng.uniform(0.75, 1.1))
    if not slatted:
        return box((0, -0.1, -0.5), (length, 0.1, height), PLASTER, FENCE, gain * 0.9)
    x = np.arange(0, length, float(rng.uniform(0.12, 0.2)))
    wide = float(rng.uniform(0.05, 0.11))
    zero, low, top = np.zeros_like(x), np.full_like(x, 0.05), np.full_like(x, height)
    corners = np.stack(
        [
            np.stack(c, 1)
            for c in ((x, zero, low), (x + wide, zero, low), (x + wide, zero, top), (x, zero, top))
        ],
        1,
    )
    first = np.arange(len(x))[:, None] * 4
    slats = surface(corners, np.concatenate([first + (0, 1, 2), first + (0, 2, 3)]), WOOD, FENCE, gain)
    rails = [box((0, 0.01, z), (length, 0.05, z + 0.08), WOOD, FENCE, gain) for z in (0.25, height - 0.25)]
    posts = [
        box((p, 0.0, -0.4), (p + 0.1, 0.1, height), WOOD, FENCE, gain) for p in np.arange(0, length, 2.4)
    ]
    return merge([slats, *rails, *posts])


def lamp(rng: np.random.Generator) -> Mesh:
    """Shape a street lamp whose arm reaches along +x."""
    high = float(rng.uniform(4.5, 8.5))
    gain = float(rng.uniform(0.5, 1.3))
    parts = [tube((0, 0, -0.2), (0, 0, high), (0.09, 0.055), METAL, POLE, 8, gain=gain)]
    if rng.random() < 0.6:
        parts.append(tube((0, 0, high - 0.1), (1.2, 0, high), (0.04, 0.04), METAL, POLE, 6, gain=gain))
        parts.append(box((0.9, -0.12, high - 0.05), (1.5, 0.12, high + 0.08), METAL, POLE, gain))
    else:
        parts.append(box((-0.2, -0.2, high), (0.2, 0.2, high + 0.3), METAL, POLE, gain))
    return merge(parts)


def sign(rng: np.random.Generator) -> Mesh:
    """Shape one or two traffic signs on a post, facing -x."""
    high = float(rng.uniform(2.2, 2.9))
    parts = [tube((0.03, 0, -0.2), (0.03, 0, high), (0.035, 0.035), METAL, POLE, 6)]
    for i in range(int(rng.integers(1, 3))):
        size, centre = float(rng.uniform(0.25, 0.42)), high - 0.35 - 0.75 * i
        sides = int(rng.choice([3, 4, 12]))
        angle = np.arange(sides) * 2 * np.pi / sides + np.pi / 2
        rim = np.stack([np.zeros(sides), size * np.cos(angle), centre + size * np.sin(angle)], 1)
        fan = [(0, j, j + 1) for j in range(1, sides - 1)]
        parts.append(surface(rim, fan, SIGN, TRAFFIC_SIGN, float(rng.uniform(0.6, 1.5))))
    return merge(parts)


def clutter(rng: np.random.Generator) -> Mesh:
    """Shape a bin, a switch box or a bollard."""
    kind = int(rng.integers(0, 3))
    gain = float(rng.uniform(0.5, 1.3))
    if kind == 0:
        return box((-0.3, -0.35, 0), (0.3, 0.35, 1.1), TARPAULIN, OTHER_OBJECT, gain)
    if kind == 1:
        return box((-0.2, -0.5, 0), (0.2, 0.5, float(rng.uniform(0.9, 1.5))), TARPAULIN, OTHER_OBJECT, gain)
    return tube((0, 0, 0), (0, 0, 0.9), (0.07, 0.06), METAL, POLE, 8, gain=gain)
