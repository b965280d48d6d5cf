"""Which sensor a log is of: a shipped model, tried on the first clouds of its topics, another unit of one, or a model that is fitted to these clouds."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from itertools import islice
from pathlib import Path
from typing import NamedTuple

import numpy as np

from salpcc.pipeline.sensors.calibration import calibrate_scans, listed_of
from salpcc.schemas.errors import LogWarning, SensorError, SourceError
from salpcc.schemas.scan import Scan
from salpcc.stages.ingest.calibrate.find_driver import MORE, find_unit, share_identical
from salpcc.stages.ingest.calibrate.fit_moved import may_be_of
from salpcc.stages.ingest.point_cloud import times_of
from salpcc.stages.ingest.sources.bag import Bag
from salpcc.stages.lattice.aim import share_on
from salpcc.stages.lattice.find_lasers import MOST_LASERS
from salpcc.stages.lattice.list_motion import undo
from salpcc.stages.lattice.sensor_model import SENSORS, SensorModel, load_sensor
from salpcc.stages.lattice.timed_motion import find_timed_motion, timed_places

AUTO, OTHERWISE, OWN = "auto", "hdl64e", "calibrated"
_CLOUDS = 2  # of each topic
_FITTED = 4  # of the topic with most points, that a model is fitted to
_LEAST = 0.5  # of the returns that must lie on the lattice
_NEAR, _NEARLY = 0.002, 0.9  # metres from it, and of the returns that must be so near
# Of the returns, that must come back to the bit for nothing else to be tried: of a shipped model's, of another unit's.
_PROVEN, _SURE = 0.9, 0.999
_BESIDE = 0.1  # metres that another unit's lasers may make of their looking elsewhere


class Chosen(NamedTuple):
    """A model, and the share of the returns of the first clouds that lie on its lattice, or ``within`` metres of it.

    ``unit``: the model of this very sensor, where no shipped one is; ``name`` is that of the shipped one whose lasers look elsewhere, or OWN. ``share`` is 0 where no model holds for most of them, None where nothing can be read: the
    run will say why, and what of the log stays behind.
    """

    name: str
    share: float | None
    within: float = 0.0
    unit: SensorModel | None = None


def choose_sensor(log: Path, sequence: str, topics: tuple[str, ...]) -> Chosen:
    """Choose the model of the first clouds of a log; OTHERWISE where there is none.

    Clouds may be of another unit than the one that a shipped model is of: then every laser's own numbers are found again; or of a sensor, or by a driver, that no shipped model is of: then a model is fitted, as ``calibrate`` does. They may be of
    a sensor whose driver was another, which rounds azimuths otherwise or not at all: then nearly all of them are next to the lattice, and corrections are small.
    """
    many = _first_clouds(log, sequence, topics)
    clouds = _few(many)
    if not clouds:
        return Chosen(OTHERWISE, None)
    sensors = [load_sensor(file.stem) for file in sorted(SENSORS.glob("*.json"))]
    best, share = _best(sensors, clouds, _share)
    on, same = Chosen(best.name, share) if share > _LEAST else None, 0.0
    if on is not None:
        same = _identical(best, clouds)
        if best.driver is None or same > _PROVEN:
            return on
    best, share = _best(sensors, clouds, _share_moved)
    if share > _LEAST:
        return Chosen(best.name, share)
    found = _find_unit(sensors, [scan for scans in many for scan in scans])
    if found is not None:
        return found
    own = _fitted(many)
    if own is not None:
        share = max(_mean(own, clouds, share_of) for share_of in (_share, _share_moved))
        if share > _LEAST and (on is None or _identical(own, clouds) > same):
            return Chosen(OWN, share, unit=own)
    if on is not None:
        return on
    best, share = _best(sensors, clouds, _share_near)
    if share <= _NEARLY and own is not None:
        best, share = own, _mean(own, clouds, lambda sensor, scan: share_on(sensor, scan.points, _NEAR))
    if share <= _NEARLY:
        return Chosen(OTHERWISE, 0.0)
    return Chosen(OWN, share, _NEAR, own) if best is own else Chosen(best.name, share, _NEAR)


def choose_unit(log: Path, sequence: str, topics: tuple[str, ...], sensor: SensorModel) -> Chosen | None:
    """Choose the unit of a given sensor that the first clouds of a log are of; None where they lie on its own lattice, or are of no other unit of it."""
    if sensor.driver is None:
        return None
    many = _first_clouds(log, sequence, topics)
    clouds = _few(many)
    if not clouds or max(_mean(sensor, clouds, share_of) for share_of in (_share, _share_moved)) > _LEAST:
        return None
    every = [scan for scans in many for scan in scans]
    found = _find_unit([sensor], every)
    same = 0.0 if found is None or found.unit is None else _identical(found.unit, every)
    if same > _SURE:
        return found
    own = _fitted(many)
    if own is None or not own.n_lasers <= MORE * sensor.n_lasers <= MORE**2 * own.n_lasers:
        return found
    share = _mean(own, every, _share)
    return (
        Chosen(sensor.name, share, unit=own) if share > _NEARLY and _identical(own, every) > same else found
    )


def _few(many: list[list[Scan]]) -> list[Scan]:
    """The clouds of all topics that models are tried on."""
    return [scan for scans in many for scan in scans[:_CLOUDS]]


def _fitted(many: list[list[Scan]]) -> SensorModel | None:
    """The model that a calibration on the clouds of the topic with most points finds; None where it finds none."""
    scans = max(many, key=lambda scans: sum(map(len, scans)))
    try:
        return calibrate_scans([listed_of(scan) for scan in scans], OWN).fit.model
    except (SensorError, np.linalg.LinAlgError):
        return None


def _mean(sensor: SensorModel, clouds: list[Scan], share_of: Callable[[SensorModel, Scan], float]) -> float:
    return float(np.mean([share_of(sensor, scan) for scan in clouds]))


def _identical(sensor: SensorModel, clouds: list[Scan]) -> float:
    """Share of the returns of clouds that a model gives back bit for bit."""
    return share_identical(sensor, np.concatenate([scan.points[:, :3] for scan in clouds]))


def _best(
    sensors: list[SensorModel], clouds: list[Scan], share_of: Callable[[SensorModel, Scan], float]
) -> tuple[SensorModel, float]:
    """The sensor of the largest share of all clouds, and that."""
    shares = [_mean(sensor, clouds, share_of) for sensor in sensors]
    best = int(np.argmax(shares))
    return sensors[best], shares[best]


def _find_unit(sensors: list[SensorModel], clouds: list[Scan]) -> Chosen | None:
    """The unit of a shipped sensor that the clouds are of; None where there is none."""
    points = np.concatenate([scan.points[:, :3] for scan in clouds])
    rings = [None if scan.cloud is None else scan.cloud.rings() for scan in clouds]
    ring = None
    if all(one is not None and one.max(initial=0) < MOST_LASERS for one in rings):
        ring = np.concatenate(rings).astype(np.int64)  # type: ignore[arg-type]
    for sensor in sensors:
        if share_on(sensor, points, _BESIDE) < _NEARLY:
            continue
        unit = find_unit(sensor, points, ring)
        share = 0.0 if unit is None else _mean(unit, clouds, _share)
        if share > _NEARLY:
            return Chosen(sensor.name, share, unit=unit)
    return None


def _share(sensor: SensorModel, scan: Scan) -> float:
    """Share of a cloud's returns on a lattice."""
    return share_on(sensor, scan.points)


def _share_near(sensor: SensorModel, scan: Scan) -> float:
    """Share of a cloud's returns next to a lattice of a known driver."""
    return share_on(sensor, scan.points, _NEAR) if sensor.driver is not None else 0.0


def _share_moved(sensor: SensorModel, scan: Scan) -> float:
    """Share of a cloud's returns on a lattice, once a motion by time is undone; 0 where there is none, or the cloud tells no rings and times."""
    if scan.cloud is None or sensor.driver is None:
        return 0.0
    rings, times = scan.cloud.rings(), times_of(scan.cloud)
    if rings is None or times is None or rings.max(initial=0) >= MOST_LASERS or not may_be_of(sensor, rings):
        return 0.0
    found = find_timed_motion(scan.points, sensor, times, rings.astype(np.uint8))
    if found is None:
        return 0.0
    still = undo(scan.points.astype(np.float64), timed_places(times, found[1]), found[0])
    return share_on(sensor, still.astype(np.float32))


def _first_clouds(log: Path, sequence: str, topics: tuple[str, ...]) -> list[list[Scan]]:
    """The first clouds of each topic that can be read and are not empty; topics without any are left out."""
    bag = Bag()
    many: list[list[Scan]] = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", LogWarning)  # the run will say so
        try:
            refs = bag.scans(log, sequence, topics)
        except SourceError:
            return []
        for topic in sorted({ref.topic for ref in refs}):
            clouds = []
            for ref in islice((ref for ref in refs if ref.topic == topic), _FITTED):
                try:
                    scan = bag.read(ref, with_labels=False)
                except SourceError:
                    continue
                if len(scan):
                    clouds.append(scan)
            if clouds:
                many.append(clouds)
    return many
