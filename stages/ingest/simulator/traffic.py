"""Send moving cars, trucks, buses, cyclists and pedestrians along the street."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from salpcc.stages.ingest.simulator import large_vehicles, people, vehicles
from salpcc.stages.ingest.simulator.drive import Drive
from salpcc.stages.ingest.simulator.ground import KERB, Stretch, height
from salpcc.stages.ingest.simulator.mesh import Mesh

F64 = NDArray[np.float64]
# SemanticKITTI's moving twins of car, bicyclist, person, motorcyclist, bus, truck; of trams, and of other vehicles.
MOVING_CAR, MOVING_BICYCLIST, MOVING_PERSON, MOVING_MOTORCYCLIST, MOVING_BUS, MOVING_TRUCK = (
    252,
    253,
    254,
    255,
    257,
    258,
)
MOVING_TRAM, MOVING_OTHER_VEHICLE = 256, 259
_MOVING = {
    vehicles.TRUCK: MOVING_TRUCK,
    vehicles.BUS: MOVING_BUS,
    vehicles.OTHER_VEHICLE: MOVING_OTHER_VEHICLE,
    large_vehicles.TRAM: MOVING_TRAM,
}


@dataclass(frozen=True, eq=False)
class Mover:
    """A thing that keeps its distance from the axis and goes along it.

    ``pace`` is None for a vehicle that keeps its gap to the own car; else metres per second along
    the axis. ``start`` is its length (or gap) at time 0.
    """

    mesh: Mesh
    start: float
    pace: float | None
    left: float
    lift: float
    road: float

    def pose(self, drive: Drive, t: float) -> tuple[float, F64]:
        """Return heading and position at time ``t``."""
        s = self.start + (float(drive.length(t)) if self.pace is None else self.pace * t)
        at, beside = np.float64(s), np.float64(self.left)
        place = drive.line.place(at, beside)
        place[2] += float(height(at, beside, self.road)) + self.lift
        back = self.pace is not None and self.pace < 0
        return float(drive.line.angle(at)) + (np.pi if back else 0.0), place


def spread(drive: Drive, road: float, stretches: list[Stretch], first_instance: int) -> list[Mover]:
    """Draw the movers of a drive so that each comes near the own car at some time."""
    config = drive.config
    rng = np.random.default_rng((config.seed, 5))
    duration = config.scans * config.period_s
    kinds = [_vehicle, _walker, _vehicle, _walker, _cyclist]
    movers: list[Mover] = []
    slots = [float(g) for g in rng.permutation([14.0, -13.0, 27.0, -26.0, 41.0])]
    oncoming = float(rng.uniform(5, 30))
    for i in range(config.movers):
        instance = first_instance + 1 + i
        meeting = float(rng.uniform(0, duration))
        near = float(drive.length(meeting)) + float(rng.uniform(-20, 35))
        side = int(rng.choice((1, -1)))
        edge = next(
            (st.edge(road) for st in stretches if st.side == side and st.start <= near <= st.end), road + 2
        )
        kind = kinds[i % len(kinds)]
        if kind is _vehicle:
            mesh = _vehicle(rng, instance, config.large)
            if slots and rng.random() < 0.4 and config.speed_mps > 0:
                movers.append(Mover(mesh, slots.pop(), None, drive.lane, 0.0, road))
            else:
                pace = -max(config.speed_mps, 6.0) * 1.1
                movers.append(Mover(mesh, oncoming, pace, -drive.lane, 0.0, road))
                oncoming += float(rng.uniform(14, 14 + 2.2 * duration * 10 / (config.movers + 1)))
        elif kind is _walker:
            pace = float(rng.choice((1, -1)) * rng.uniform(0.8, 1.8))
            left = side * (edge - float(rng.uniform(0.4, 1.4)))
            movers.append(Mover(_walker(rng, instance), near - pace * meeting, pace, left, KERB, road))
        else:
            pace = float(rng.uniform(3, 6)) * (1 if side < 0 else -1)
            movers.append(
                Mover(_cyclist(rng, instance), near - pace * meeting, pace, side * (road - 0.3), 0.0, road)
            )
    return movers


def _vehicle(rng: np.random.Generator, instance: int, large: float) -> Mesh:
    if large and rng.random() < large:
        mesh = large_vehicles.large_vehicle(rng)
        return mesh.labelled(_MOVING[int(mesh.label[0])], instance)
    kind = rng.random()
    if kind < 0.86:
        return vehicles.car(rng).labelled(MOVING_CAR, instance)
    if kind < 0.95:
        return vehicles.truck(rng).labelled(MOVING_TRUCK, instance)
    return vehicles.bus(rng).labelled(MOVING_BUS, instance)


def _walker(rng: np.random.Generator, instance: int) -> Mesh:
    return people.person(rng).labelled(MOVING_PERSON, instance)


def _cyclist(rng: np.random.Generator, instance: int) -> Mesh:
    if rng.random() < 0.8:
        return people.bicyclist(rng).labelled(MOVING_BICYCLIST, instance)
    return people.motorcyclist(rng).labelled(MOVING_MOTORCYCLIST, instance)
