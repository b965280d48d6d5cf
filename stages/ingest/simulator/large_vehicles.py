"""Shape large vehicles: lorries of several kinds, delivery vans, coaches, trams, caravans.

Each stands on z = 0 with its middle at x = y = 0 and looks along +x, as those of :mod:`.vehicles` do.
"""

from __future__ import annotations

import numpy as np

from salpcc.stages.ingest.simulator.mesh import Kinds, Mesh, box, drawn, extrude, merge, tube
from salpcc.stages.ingest.simulator.vehicles import (
    BUS,
    GLASS,
    LAMP,
    METAL,
    OTHER_VEHICLE,
    PAINT,
    TARPAULIN,
    TRUCK,
    bus,
    truck,
    wheels,
)

TRAM = 16
_CAB_WIDTH, _LORRY_WIDTH = 2.45, 2.5  # metres


def _cab(nose: float, gain: float, rng: np.random.Generator, high: float) -> list[Mesh]:
    """The cab of a lorry whose front is at x = ``nose``, metres."""
    half, long = _CAB_WIDTH / 2, float(rng.uniform(1.7, 2.2))
    slope = float(rng.uniform(0.05, 0.3))
    side = [(nose, 0.5), (nose - 0.02, 1.4), (nose - slope, high), (nose - long, high), (nose - long, 0.6)]
    parts = [
        extrude(side, 2 * half, PAINT, TRUCK, gain),
        box((nose - 0.12, 0.1 - half, 1.5), (nose + 0.03, half - 0.1, high - 0.45), GLASS, TRUCK),
        box((nose - 1.2, -half - 0.01, 1.5), (nose - 0.35, half + 0.01, high - 0.5), GLASS, TRUCK),
    ]
    parts += [
        box((nose - 0.1, y - 0.2, 0.6), (nose + 0.04, y + 0.2, 0.85), LAMP, TRUCK) for y in (-0.95, 0.95)
    ]
    parts += [
        box((nose - 0.35, y - 0.1, 1.5), (nose - 0.15, y + 0.1, 2.1), METAL, TRUCK) for y in (-1.4, 1.4)
    ]
    return parts


def semitrailer(rng: np.random.Generator) -> Mesh:
    """Shape a tractor and its trailer: a curtain, a tank or a flat bed."""
    long, high = float(rng.uniform(9.0, 13.6)), float(rng.uniform(3.5, 4.0))
    rear, half, gain = -long / 2 - 1.3, _LORRY_WIDTH / 2, float(rng.uniform(0.4, 1.6))
    front = rear + long
    kind = rng.random()
    if kind < 0.65:
        load = [box((rear, -half, 1.15), (front, half, high), TARPAULIN, TRUCK, float(rng.uniform(0.5, 1.3)))]
    elif kind < 0.85:
        z, radius = 2.3, 1.15
        load = [tube((rear, 0, z), (front, 0, z), (radius, radius), METAL, TRUCK, 14, True, 1.4)]
    else:
        piled = float(rng.uniform(1.6, 2.8))
        load = [
            box((rear, -half, 1.1), (front, half, 1.35), METAL, TRUCK),
            box((rear + 1.0, -half + 0.2, 1.35), (front - 2.0, half - 0.2, piled), TARPAULIN, TRUCK, 0.7),
        ]
    parts = [
        *load,
        *_cab(front + 2.5, gain, rng, float(rng.uniform(2.8, 3.8))),
        box((rear, -0.5, 0.8), (front + 1.0, 0.5, 1.15), METAL, TRUCK, 0.5),
        *wheels([front + 1.4, front - 1.2, rear + 1.2, rear + 2.4, rear + 3.6], half, 0.5, TRUCK),
    ]
    return merge(parts)


def tipper(rng: np.random.Generator) -> Mesh:
    """Shape a tipper or a refuse lorry: a cab and a body that slopes at the rear."""
    long, high, half = float(rng.uniform(4.2, 6.2)), float(rng.uniform(2.4, 3.6)), _LORRY_WIDTH / 2
    front, rear, lean = long / 2, -long / 2, float(rng.uniform(0.2, 1.4))
    body = [(front, 1.0), (front, high), (rear + lean, high), (rear, 1.5), (rear + 0.2, 1.0)]
    parts = [
        extrude(body, 2 * half, PAINT, TRUCK, float(rng.uniform(0.5, 1.8))),
        *_cab(front + 2.2, float(rng.uniform(0.5, 1.8)), rng, float(rng.uniform(2.5, 3.0))),
        box((rear, -0.5, 0.6), (front + 1.0, 0.5, 1.0), METAL, TRUCK, 0.5),
        *wheels([front + 1.1, rear + 1.0, rear + 2.3], half, 0.5, TRUCK),
    ]
    return merge(parts)


def delivery_van(rng: np.random.Generator) -> Mesh:
    """Shape a high van: panels or windows all around, or a box behind a cab."""
    label = OTHER_VEHICLE
    half, width = float(rng.uniform(5.2, 7.0)) / 2, float(rng.uniform(1.95, 2.2))
    high, gain = float(rng.uniform(2.3, 3.0)), float(rng.uniform(0.4, 1.8))
    bonnet = half - float(rng.uniform(0.7, 1.1))
    body = [(half, 0.35), (half - 0.05, 0.95), (bonnet, 1.2), (bonnet - 0.75, min(high, 2.3)), (-half, high), (-half, 0.35)]  # fmt: skip
    parts = [
        extrude(body, width, PAINT, label, gain),
        *wheels([half - 0.95, 1.0 - half], width / 2, 0.34, label),
    ]
    glass = width / 2 + 0.01
    if rng.random() < 0.35:  # people, not parcels
        parts.append(box((-half + 0.3, -glass, 1.25), (bonnet - 0.7, glass, 1.95), GLASS, label))
    elif rng.random() < 0.4:
        parts.append(
            box((-half, -width / 2 - 0.1, 0.8), (bonnet - 1.5, width / 2 + 0.1, high + 0.3), TARPAULIN, label)
        )
    parts += [
        box((bonnet - 0.9, -glass, 1.25), (bonnet - 0.15, glass, 1.9), GLASS, label),
        *(box((half - 0.1, y - 0.2, 0.65), (half + 0.02, y + 0.2, 0.85), LAMP, label) for y in (-0.75, 0.75)),
    ]
    return merge(parts)


def coach(rng: np.random.Generator) -> Mesh:
    """Shape a coach: higher than a city bus, of one piece of glass along the sides."""
    half, high, gain = (
        float(rng.uniform(4.5, 6.5)),
        float(rng.uniform(3.2, 3.8)),
        float(rng.uniform(0.5, 1.6)),
    )
    parts = [
        extrude([(half, 0.35), (half - 0.3, high), (-half, high), (-half, 0.35)], 2.5, PAINT, BUS, gain),
        box((0.4 - half, -1.26, 1.5), (half - 0.9, 1.26, high - 0.6), GLASS, BUS),
        box((half - 0.4, -1.1, 1.1), (half - 0.02, 1.1, high - 0.5), GLASS, BUS),
        *wheels([half - 2.4, 2.2 - half, 3.4 - half], 1.25, 0.5, BUS),
    ]
    return merge(parts)


def tram(rng: np.random.Generator) -> Mesh:
    """Shape a tram of one or two cars, low over its rails."""
    parts, long, gain = [], float(rng.uniform(7.0, 9.5)), float(rng.uniform(0.6, 1.6))
    cars = int(rng.integers(1, 3))
    for k in range(cars):
        rear = (k - cars / 2) * (long + 0.6)
        parts += [
            box((rear, -1.2, 0.3), (rear + long, 1.2, 1.2), PAINT, TRAM, gain),
            box((rear + 0.05, -1.17, 1.2), (rear + long - 0.05, 1.17, 2.5), GLASS, TRAM),
            box((rear, -1.2, 2.5), (rear + long, 1.2, 3.3), PAINT, TRAM, gain),
        ]
        parts += [box((x, -1.2, 1.1), (x + 0.18, 1.2, 2.6), PAINT, TRAM, gain) for x in np.arange(rear, rear + long, 1.6)]  # fmt: skip
    return merge(parts)


def caravan(rng: np.random.Generator) -> Mesh:
    """Shape a caravan or a trailer under a sheet."""
    half, high = float(rng.uniform(1.5, 3.2)), float(rng.uniform(1.5, 2.6))
    gain = float(rng.uniform(0.8, 1.4))
    front = float(rng.uniform(0.0, 0.5))
    side = [(half, 0.9), (half - front, high), (-half, high), (-half, 0.4), (half - 0.2, 0.4)]
    parts = [
        extrude(side, float(rng.uniform(1.7, 2.3)), PAINT, OTHER_VEHICLE, gain),
        box((half - 0.2, -0.05, 0.4), (half + 1.1, 0.05, 0.5), METAL, OTHER_VEHICLE),
        *wheels([0.0], 0.95, 0.32, OTHER_VEHICLE),
    ]
    return merge(parts)


_FLEET: Kinds = (
    (delivery_van, 0.34),
    (truck, 0.16),
    (semitrailer, 0.14),
    (tipper, 0.12),
    (bus, 0.06),
    (coach, 0.06),
    (tram, 0.06),
    (caravan, 0.06),
)


def large_vehicle(rng: np.random.Generator) -> Mesh:
    """Shape one, of a kind drawn at random."""
    return drawn(_FLEET, rng)(rng)
