"""Say what to simulate: one frozen, hashable value per sequence."""

from __future__ import annotations

from dataclasses import dataclass

from salpcc.schemas.errors import UsageError

SCENES = ("city", "suburb", "country", "mixed")


@dataclass(frozen=True)
class SimulationConfig:
    """One drive.

    Attributes:
        sequence: two-digit name of the sequence folder.
        scans: number of scans, one per turn of the sensor.
        seed: everything random follows from it.
        speed_mps: mean speed of the vehicle; ``speed_wave`` is its relative swing, of period ``speed_period_s``.
        yaw: heading of the street along its length, as (wave length m, amplitude rad) pairs that add up.
        scene: what stands along the street, one of :data:`SCENES`.
        movers: number of moving cars, trucks, buses, cyclists, pedestrians near the drive.
        parked: share of the kerb that parked cars take, 0 to 1.
        large: share of all vehicles that are lorries, buses, trams, delivery vans and the like, beside the few there are.
        beside: share of the kerb without parked vehicles where walls, garages, guard rails, hoardings and large signs stand,
            each an instance of its own.
        period_s: time of one turn of the sensor.
        ticks_per_firing: encoder ticks between two firings of the whole block, of 4000 a turn.
        sensor_height: of the sensor above the road, metres.
        label_range: points beyond it are unlabelled, as in SemanticKITTI, metres.
        max_range: farthest return, metres.
        shadow: whether the own car hides what SemanticKITTI's car hides.
    """

    sequence: str = "00"
    scans: int = 10
    seed: int = 0
    speed_mps: float = 9.0
    speed_wave: float = 0.15
    speed_period_s: float = 17.0
    yaw: tuple[tuple[float, float], ...] = ((210.0, 0.30), (83.0, 0.06))
    scene: str = "mixed"
    movers: int = 12
    parked: float = 0.25
    large: float = 0.0
    beside: float = 0.0
    period_s: float = 0.1037
    ticks_per_firing: float = 1.851
    sensor_height: float = 1.73
    label_range: float = 50.0
    max_range: float = 79.0
    shadow: bool = True

    def __post_init__(self) -> None:
        """Refuse what cannot be simulated.

        Raises:
            UsageError: a value is out of its range.
        """
        if self.scans < 1 or self.movers < 0 or self.seed < 0:
            raise UsageError(
                f"simulation {self.sequence}: scans must be positive, movers and seed not negative"
            )
        if self.scene not in SCENES:
            raise UsageError(
                f"simulation {self.sequence}: scene {self.scene!r} is not one of {', '.join(SCENES)}"
            )
        if not 0 <= self.speed_mps <= 40 or not 0 <= self.speed_wave < 1:
            raise UsageError(f"simulation {self.sequence}: speed must be 0 to 40 m/s and its wave 0 to 1")
        if self.ticks_per_firing < 1:
            raise UsageError(f"simulation {self.sequence}: a firing takes at least one encoder tick")
