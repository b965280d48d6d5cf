"""Shape vehicles: cars, vans, trucks, buses, motorcycles, bicycles.

Each stands on z = 0 with its middle at x = y = 0 and looks along +x.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from salpcc.stages.ingest.simulator.materials import NAMES
from salpcc.stages.ingest.simulator.mesh import Mesh, box, extrude, merge, tube

PAINT, GLASS, TYRE, LAMP, SIGN = (NAMES[n] for n in ("paint", "glass", "tyre", "lamp", "sign"))
METAL, TARPAULIN = NAMES["metal"], NAMES["tarpaulin"]
CAR, BICYCLE, BUS, MOTORCYCLE, TRUCK, OTHER_VEHICLE = 10, 11, 13, 15, 18, 20

# Length, width, height in metres; then the side profiles of the lower body and of the cabin, front to
# rear: x in half lengths, z in metres.
_SHAPES: dict[str, tuple[float, float, float, list[tuple[float, float]], list[tuple[float, float]]]] = {
    "hatchback": (4.0, 1.72, 1.48, [(1, 0.45), (0.96, 0.62), (0.45, 0.88), (-0.96, 0.92), (-1, 0.45)],
                  [(0.45, 0.88), (0.06, 1.40), (-0.6, 1.44), (-0.95, 0.92)]),
    "saloon": (4.6, 1.78, 1.44, [(1, 0.45), (0.97, 0.64), (0.42, 0.88), (-0.65, 0.92), (-0.98, 0.90), (-1, 0.45)],
               [(0.42, 0.88), (0.08, 1.38), (-0.38, 1.40), (-0.72, 0.92)]),
    "estate": (4.7, 1.80, 1.50, [(1, 0.45), (0.97, 0.64), (0.44, 0.90), (-0.97, 0.94), (-1, 0.45)],
               [(0.44, 0.90), (0.12, 1.44), (-0.85, 1.46), (-0.98, 0.94)]),
    "offroad": (4.5, 1.86, 1.70, [(1, 0.55), (0.97, 0.85), (0.45, 1.05), (-0.98, 1.08), (-1, 0.55)],
                [(0.45, 1.05), (0.15, 1.62), (-0.88, 1.66), (-0.98, 1.08)]),
    "van": (5.1, 1.95, 2.00, [(1, 0.50), (0.97, 0.85), (0.78, 1.10), (-1.0, 1.15), (-1, 0.50)],
            [(0.78, 1.10), (0.55, 1.85), (-0.98, 1.92), (-1.0, 1.15)]),
}  # fmt: skip


def wheels(places: list[float], half_width: float, radius: float, label: int) -> list[Mesh]:
    """Shape a pair of wheels at each of ``places`` along x, metres."""
    return [
        tube((x, y - 0.1, radius), (x, y + 0.1, radius), (radius, radius), TYRE, label, sides=12)
        for x in places
        for y in (half_width - 0.1, 0.1 - half_width)
    ]


def car(rng: np.random.Generator, label: int = CAR) -> Mesh:
    """Shape a car or van of random make, size and paint."""
    kind = str(rng.choice(list(_SHAPES), p=[0.32, 0.22, 0.2, 0.14, 0.12]))
    length, width, height, lower, cabin = _SHAPES[kind]
    half = length / 2
    gain = float(rng.uniform(0.0, 0.3) if rng.random() < 0.45 else rng.uniform(0.5, 1.8))
    body = [(x * half, z) for x, z in lower] + [(-half * 0.97, 0.24), (half * 0.97, 0.22)]
    lean = 0.12 if kind != "van" else 0.06
    top = np.array([0.0, 1, 1, 0])
    side = width / 2 - 0.03 - lean * top
    windows = np.array([(x * half, z) for x, z in cabin])
    front, rear = windows[1], windows[2]
    z = height - 0.04
    parts = [
        extrude(body, width, PAINT, label, gain),
        extrude(
            windows, (side, -side), PAINT if kind == "van" and rng.random() < 0.5 else GLASS, label, gain
        ),
        box((rear[0], -side[1], z - 0.06), (front[0], side[1], z), PAINT, label, gain),
        *wheels([half * 0.62, -half * 0.6], width / 2, 0.32, label),
    ]
    for y, inner in ((width / 2 - 0.04, side[1]), (0.04 - width / 2, -side[1])):
        for i in range(2):
            parts.append(tube((*windows[[0, 3][i]][:1], y, windows[[0, 3][i]][1]), (windows[1 + i][0], inner, z),
                              (0.05, 0.05), PAINT, label, sides=5, gain=gain))  # fmt: skip
        parts.append(tube((-0.1, y, 0.9), (-0.15, inner, z), (0.05, 0.05), PAINT, label, sides=5, gain=gain))
        for x in (half * 0.96, -half * 0.99):
            low, high = sorted((y * 0.72, y * 0.98))
            parts.append(box((x - 0.03, low, 0.6), (x + 0.03, high, 0.76), LAMP, label))
    for x in (half * 1.005, -half * 1.005):
        parts.append(box((x - 0.01, -0.26, 0.4), (x + 0.01, 0.26, 0.52), SIGN, label, 1.2))
    return merge(parts).moved((0, 0, 0), 0.0, (rng.uniform(0.95, 1.06), rng.uniform(0.97, 1.03), height / z))


def truck(rng: np.random.Generator, label: int = TRUCK) -> Mesh:
    """Shape a lorry: a cab and a load box."""
    load, high = float(rng.uniform(4.0, 8.0)), float(rng.uniform(2.9, 3.7))
    gain = float(rng.uniform(0.5, 1.5))
    nose = load / 2 + 1.1
    parts = [
        box((nose - 2.0, -1.15, 0.6), (nose, 1.15, 2.6), PAINT, label, gain),
        box((nose - 0.05, -1.0, 1.5), (nose + 0.02, 1.0, 2.3), GLASS, label),
        box((nose - 1.4, -1.17, 1.5), (nose - 0.4, 1.17, 2.2), GLASS, label),
        box((-nose, -1.25, 1.0), (nose - 2.1, 1.25, high), TARPAULIN, label, float(rng.uniform(0.6, 1.2))),
        box((-nose, -0.5, 0.5), (nose - 0.2, 0.5, 1.0), METAL, label, 0.5),
        *wheels([nose - 1.2, -nose + 1.0, -nose + 2.2], 1.2, 0.48, label),
    ]
    return merge(parts)


def bus(rng: np.random.Generator, label: int = BUS) -> Mesh:
    """Shape a city bus with its band of windows."""
    gain = float(rng.uniform(0.7, 1.6))
    parts = [
        box((-6.0, -1.27, 0.35), (6.0, 1.27, 1.25), TARPAULIN, label, gain),
        box((-5.97, -1.24, 1.25), (5.97, 1.24, 2.4), GLASS, label),
        box((-6.0, -1.27, 2.4), (6.0, 1.27, 3.05), TARPAULIN, label, gain),
        *wheels([3.6, -3.4], 1.25, 0.48, label),
    ]
    parts += [
        box((x, -1.27, 1.2), (x + 0.15, 1.27, 2.45), TARPAULIN, label, gain)
        for x in np.arange(-6.0, 6.0, 1.46)
    ]
    return merge(parts)


def bicycle(rng: np.random.Generator, label: int = BICYCLE) -> Mesh:
    """Shape a bicycle: two thin wheels, a frame, a handlebar."""
    gain = float(rng.uniform(0.8, 2.4))
    angle = np.linspace(0, 2 * np.pi, 11)
    parts = []
    for x in (0.52, -0.52):
        rim = np.stack([x + 0.33 * np.cos(angle), np.zeros(11), 0.34 + 0.33 * np.sin(angle)], 1)
        parts += [tube(a, b, (0.022, 0.022), TYRE, label, 4, False, 4.0) for a, b in pairwise(rim)]
    bars = [((0.52, 0, 0.34), (0.38, 0, 0.95)), ((0.38, 0, 0.8), (-0.15, 0, 0.75)), ((0.38, 0, 0.7), (-0.05, 0, 0.3)),
            ((-0.05, 0, 0.3), (-0.2, 0, 0.9)), ((-0.52, 0, 0.34), (-0.05, 0, 0.3)), ((0.36, -0.28, 1.0), (0.36, 0.28, 1.0))]  # fmt: skip
    parts += [tube(a, b, (0.025, 0.025), METAL, label, 5, False, gain) for a, b in bars]
    parts.append(box((-0.32, -0.08, 0.88), (-0.08, 0.08, 0.95), TYRE, label))
    return merge(parts)


def motorcycle(rng: np.random.Generator, label: int = MOTORCYCLE) -> Mesh:
    """Shape a motorcycle or scooter."""
    gain = float(rng.uniform(0.3, 1.2))
    parts = [
        *[tube((x, -0.07, 0.3), (x, 0.07, 0.3), (0.3, 0.3), TYRE, label, 12) for x in (0.7, -0.65)],
        extrude(
            [(0.5, 0.5), (0.3, 0.95), (-0.2, 0.8), (-0.85, 0.85), (-0.5, 0.35), (0.2, 0.25)],
            0.3,
            PAINT,
            label,
            gain,
        ),
        tube((0.7, 0, 0.3), (0.45, 0, 1.05), (0.05, 0.05), METAL, label, 5),
        tube((0.45, -0.35, 1.05), (0.45, 0.35, 1.05), (0.03, 0.03), METAL, label, 5),
        box((0.55, -0.1, 0.8), (0.65, 0.1, 1.0), LAMP, label),
    ]
    return merge(parts)
