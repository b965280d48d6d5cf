"""Simulate a drive scan by scan."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from salpcc.stages.ingest.simulator import firing, measure, street, traffic
from salpcc.stages.ingest.simulator.caster import Caster
from salpcc.stages.ingest.simulator.config import SimulationConfig
from salpcc.stages.ingest.simulator.drive import Drive, lay
from salpcc.stages.lattice.lattice import unproject
from salpcc.stages.lattice.sensor_model import SensorModel
from salpcc.stages.lattice.untwist import twist

F64 = NDArray[np.float64]
_ROADS = {"city": 4.5, "suburb": 3.8, "country": 4.2, "mixed": 4.2}  # metres from the axis to the road's edge
# Of real points, 0.3 % miss the rounded model by 1 mm in one coordinate; so must these.
_MODEL_ERROR = 1.3e-6  # metres


@dataclass(frozen=True, eq=False)
class SimulatedScan:
    """One turn, in file order: ring after ring, azimuth rising in each.

    Attributes:
        number: scan number in the sequence; ``time`` is its seconds since the first.
        points: ``(N, 3)`` float32, compensated for the motion, as SemanticKITTI publishes them.
        raw: ``(N, 3)`` float32, as the sensor measured them: whole millimetres.
        intensity: ``(N,)`` float32, whole hundredths.
        labels: ``(N,)`` uint32, instance in the upper 16 bits.
        motion: ``(6,)`` float64 ``(v, w)`` of the turn.
        pose: ``(4, 4)`` float64, sensor in the world at the middle of the turn.
        laser, tick, count: ``(N,)`` place of each point on the sensor's lattice.
    """

    number: int
    time: float
    points: NDArray[np.float32]
    raw: NDArray[np.float32]
    intensity: NDArray[np.float32]
    labels: NDArray[np.uint32]
    motion: F64
    pose: F64
    laser: NDArray[np.uint8]
    tick: NDArray[np.int32]
    count: NDArray[np.int32]

    def __len__(self) -> int:
        """Number of points."""
        return len(self.points)


def simulate_scans(config: SimulationConfig, sensor: SensorModel) -> Iterator[SimulatedScan]:
    """Drive down the street and yield its scans one after the other.

    The same config gives the same scans on the same machine; another processor may trace a ray along an
    edge differently.
    """
    road = _ROADS[config.scene]
    drive = lay(config, -0.44 * road)
    ground, pieces, instances = street.furnish(config, drive.line, road)
    movers = traffic.spread(drive, road, street.stretches_of(config, drive.line), instances)
    caster = Caster(drive, ground, pieces, movers)
    for number in range(config.scans):
        yield _scan(number, drive, caster, sensor)


def _scan(number: int, drive: Drive, caster: Caster, sensor: SensorModel) -> SimulatedScan:
    config = drive.config
    rng = np.random.default_rng((config.seed, 6, number))
    t = number * config.period_s
    rotation, position = drive.pose(t)
    motion = drive.motion(t)

    ticks = firing.firing_ticks(sensor.ticks_per_turn, config.ticks_per_firing, rng)
    shots = firing.shots(sensor, ticks)
    free = ~firing.hidden(sensor, shots.tick) if config.shadow else np.ones(shots.tick.shape, bool)
    laser, column = np.nonzero(free)
    s = shots.s[laser, column]
    turn, shift = Rotation.from_rotvec(s[:, None] * motion[3:]), s[:, None] * motion[:3]
    # The sensor at place s of the turn stands where the compensation will put the point from.
    origin = (turn.apply(shots.origin[laser, column]) + shift) @ rotation.T + position
    direction = turn.apply(shots.direction[laser, column]) @ rotation.T
    hits = caster.cast(origin, direction, t, -s * config.period_s)

    reach = np.minimum(hits.distance, config.max_range)
    strength = measure.signal(
        hits, origin + reach[:, None] * direction, firing.laser_gain(sensor)[laser], rng
    )
    kept = measure.returns(hits, strength, config.max_range, rng)
    distance = measure.ranges(hits, strength, rng)
    count = np.rint((distance[kept] - sensor.d0[laser[kept]]) / sensor.count).astype(np.int32)
    kept[kept] = count > 0
    count, beam = count[count > 0], laser[kept].astype(np.uint8)
    tick = shots.tick[laser, column][kept].astype(np.int32)

    model = unproject(sensor, beam, tick, count)
    off = model + rng.normal(0, _MODEL_ERROR, model.shape)
    raw = (np.rint(off * 1000.0) / 1000.0).astype(np.float32)
    # Real files are sorted by the azimuth of the point before it was rounded, not by the tick.
    order = np.lexsort((np.arctan2(model[:, 1], model[:, 0]) % (2 * np.pi), beam))
    raw = raw[order]
    label = hits.label[kept][order]
    label[np.linalg.norm(raw, axis=1) > config.label_range] = 0
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, position
    return SimulatedScan(
        number, t, twist(raw.astype(np.float64), motion).astype(np.float32), raw, measure.intensities(hits.material[kept], strength[kept], rng)[order], label,
        motion, pose, beam[order], tick[order], count[order],
    )  # fmt: skip
