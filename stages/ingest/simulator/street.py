"""Furnish the street: stretch by stretch, houses, gardens, woods, fences, parked cars, poles, signs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from salpcc.stages.ingest.simulator import large_vehicles, plants, roadside, structures, vehicles
from salpcc.stages.ingest.simulator.config import SimulationConfig
from salpcc.stages.ingest.simulator.drive import CentreLine
from salpcc.stages.ingest.simulator.ground import KERB, Stretch, ground, height
from salpcc.stages.ingest.simulator.mesh import Kinds, Mesh, drawn

_KINDS = ("row", "houses", "green", "wall")
_MIX = {
    "city": (0.55, 0.20, 0.10, 0.15),
    "suburb": (0.05, 0.50, 0.25, 0.20),
    "country": (0.0, 0.10, 0.75, 0.15),
    "mixed": (0.12, 0.33, 0.35, 0.20),
}
_PARKED: Kinds = (
    (vehicles.car, 0.93),
    (vehicles.truck, 0.04),
    (vehicles.motorcycle, 0.03),
)


@dataclass(frozen=True, eq=False)
class Piece:
    """One thing at length ``s`` of the street, in world coordinates."""

    s: float
    mesh: Mesh


def stretches_of(config: SimulationConfig, line: CentreLine) -> list[Stretch]:
    """Draw the stretches of both sides: kind and widths of the strips."""
    out = []
    for side in (1, -1):
        rng = np.random.default_rng((config.seed, 2, side + 1))
        start = float(line.s[0])
        while start < line.s[-1] - 1:
            end = min(start + float(rng.uniform(28, 70)), float(line.s[-1]))
            kind = str(rng.choice(_KINDS, p=_MIX[config.scene]))
            parking = 2.3 if rng.random() < (0.25 if kind in ("row", "houses") else 0.08) else 0.0
            sidewalk = float(rng.uniform(1.6, 3.6)) if kind != "green" or rng.random() < 0.55 else 0.05
            verge = {"row": 0.4, "houses": float(rng.uniform(2, 6)), "green": 6.0, "wall": 0.6}[kind]
            out.append(Stretch(start, end, side, kind, parking, sidewalk, verge))
            start = end
    return out


class _Builder:
    """Puts things on the street, in street coordinates."""

    def __init__(
        self, config: SimulationConfig, line: CentreLine, road: float, crossings: list[float]
    ) -> None:
        self.config, self.line, self.road, self.crossings = config, line, road, crossings
        self.rng = np.random.default_rng((config.seed, 3))
        self.pieces: list[Piece] = []
        self.instances = 0

    def put(self, mesh: Mesh, s: float, left: float, turn: float = 0.0, kerb: float = KERB) -> None:
        """Stand a mesh on the ground at (s, left), turned from the street's heading."""
        if any(abs(s - c) < 7.0 for c in self.crossings) and abs(left) < 45:
            return
        place = self.line.place(np.float64(s), np.float64(left))
        place[2] += float(height(np.float64(s), np.float64(left), self.road)) + kerb
        self.pieces.append(Piece(s, mesh.moved(place, float(self.line.angle(np.float64(s))) + turn)))

    def named(self, mesh: Mesh) -> Mesh:
        """Make an instance of its own of a mesh of one label."""
        self.instances += 1
        return mesh.labelled(int(mesh.label[0]), self.instances)

    def along(self, st: Stretch, low: float, high: float) -> list[float]:
        """Draw lengths over a stretch with random gaps from ``low`` to ``high``."""
        out, s = [], st.start + float(self.rng.uniform(0, high))
        while s < st.end:
            out.append(s)
            s += float(self.rng.uniform(low, high))
        return out

    def kerbside(self, st: Stretch) -> None:
        """Parked vehicles, street trees, lamps, signs, bins."""
        rng, edge, side = self.rng, self.road + st.parking, st.side
        parked = self.config.parked * (1.5 if st.parking else 0.35)
        for s in self.along(st, 6.0, 7.5) if not self.config.large else self.along(st, 12.0, 19.0):
            if rng.random() < parked:
                make = drawn(_PARKED, rng)
                if self.config.large and rng.random() < self.config.large:
                    make = large_vehicles.large_vehicle
                turn = (0.0 if side < 0 else np.pi) + float(rng.normal(0, 0.02))
                left = edge - 1.15 if st.parking else edge + 0.7
                self.put(self.named(make(rng)), s, side * left, turn, 0.02)
            elif self.config.beside and rng.random() < self.config.beside:
                mesh = self.named(roadside.roadside_thing(rng))
                self.put(mesh, s, side * (edge + float(rng.uniform(0.3, 3.0))), float(rng.normal(0, 0.05)))
        for s in self.along(st, 20, 32):
            self.put(
                structures.lamp(rng), s, side * max(edge + 0.4, st.edge(self.road) - 0.4), -side * np.pi / 2
            )
        for s in self.along(st, 18, 60):
            self.put(structures.sign(rng), s, side * (edge + 0.45), 0.0 if side < 0 else np.pi)
        for s in self.along(st, 7, 36):
            self.put(structures.clutter(rng), s, side * (st.edge(self.road) - 0.4))
        if st.sidewalk > 2.2 and rng.random() < 0.5:
            for s in self.along(st, 9, 15):
                self.put(plants.tree(rng), s, side * (st.edge(self.road) - 0.3))
        for s in self.along(st, 25, 120):
            mesh = self.named(vehicles.bicycle(rng))
            self.put(mesh, s, side * (st.edge(self.road) - 0.3), float(rng.normal(0, 0.3)))

    def border(self, st: Stretch, left: float) -> None:
        """A fence, wall or hedge along the outer edge of the sidewalk, in lengths that follow the curve."""
        rng, kind = self.rng, self.rng.choice(3, p=[0.4, 0.15, 0.45])
        tall, thick = float(rng.uniform(0.9, 1.9)), float(rng.uniform(0.5, 1.0))
        for s in np.arange(st.start, st.end - 4, 4.0):
            if rng.random() < 0.9:
                part = (
                    plants.hedge(4.0, tall, thick, rng)
                    if kind == 2
                    else structures.fence(4.0, tall, rng, kind == 0)
                )
                self.put(part, float(s), st.side * left)

    def scrub(self, st: Stretch, left: float) -> None:
        """A belt of tall shrubs with gaps."""
        for s in np.arange(st.start, st.end - 5, 5.0):
            if self.rng.random() < 0.85:
                tall, thick = float(self.rng.uniform(1.8, 4.5)), float(self.rng.uniform(1.2, 2.4))
                out = left + float(self.rng.normal(0, 0.3))
                self.put(plants.hedge(5.0, tall, thick, self.rng), float(s), st.side * out)

    def backdrop(self, st: Stretch) -> None:
        """What stands behind the sidewalk: houses, gardens, woods."""
        rng, side, edge = self.rng, st.side, st.edge(self.road)
        turn = 0.0 if side > 0 else np.pi
        if st.kind in ("houses", "wall"):
            self.border(st, edge + 0.5)
        elif st.kind == "green" and rng.random() < 0.6:
            self.scrub(st, edge + float(rng.uniform(1.5, 5.0)))
        if st.kind in ("row", "houses"):
            gap = (0.0, 0.5) if st.kind == "row" else (4.0, 12.0)
            s = st.start + float(rng.uniform(*gap))
            while s < st.end - 9:
                wide = float(rng.uniform(9, 17))
                storeys = int(rng.integers(2, 5)) if st.kind == "row" else int(rng.integers(1, 3))
                left = edge + st.verge + float(rng.uniform(0, 0.3 if st.kind == "row" else 2.5))
                corner = s if side > 0 else s + wide
                self.put(
                    structures.house(wide, float(rng.uniform(8, 12)), rng, storeys), corner, side * left, turn
                )
                s += wide + float(rng.uniform(*gap))
        trees = {"row": (40, 90), "houses": (7, 16), "green": (4, 8), "wall": (4, 9)}[st.kind]
        for s in self.along(st, *trees):
            out = float(rng.uniform(1.5, 12)) if st.kind != "houses" else float(rng.choice([1.6, 14, 18]))
            self.put(plants.tree(rng), s, side * (edge + out))
        for s in self.along(st, 3, 10):
            if st.kind != "row":
                out = float(rng.uniform(0.8, 3.5) if st.kind == "houses" else rng.uniform(1.2, 14))
                self.put(plants.bush(rng, float(rng.uniform(0.4, 1.2))), s, side * (edge + out))
        out = {"row": 40.0, "houses": 30.0, "green": float(rng.uniform(10, 32)), "wall": 22.0}[st.kind]
        for s in np.arange(st.start, st.end, 15.0):
            if rng.random() < 0.93:
                wood = plants.thicket(15.0, float(rng.uniform(6, 13)), 6.0, rng)
                left = side * (edge + out) if side > 0 else side * (edge + out + 6)
                self.put(wood, float(s), left)


def furnish(config: SimulationConfig, line: CentreLine, road: float) -> tuple[Mesh, list[Piece], int]:
    """Build the whole street.

    Returns:
        the ground, the things on it ordered by length, and the number of instances given out.
    """
    rng = np.random.default_rng((config.seed, 4))
    crossings: list[float] = []
    s = float(line.s[0] + rng.uniform(20, 90))
    while s < line.s[-1] - 20:
        crossings.append(s)
        s += float(rng.uniform(60, 160))
    stretches = stretches_of(config, line)
    builder = _Builder(config, line, road, crossings)
    for st in stretches:
        builder.kerbside(st)
        builder.backdrop(st)
    for c in crossings:
        for left in (48.0, -54.0):  # the side streets end in trees too
            builder.put(plants.thicket(36.0, float(rng.uniform(7, 12)), 6.0, rng), c - 18.0, left)
    pieces = sorted(builder.pieces, key=lambda p: p.s)
    return ground(line, stretches, road, crossings), pieces, builder.instances
