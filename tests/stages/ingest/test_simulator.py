"""The simulator: its scans lie on the lattice, carry labels, and undo like KITTI's."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree

from salpcc.schemas.errors import UsageError
from salpcc.schemas.labels import CLASSES, classes_of_labels
from salpcc.stages.ingest.simulator import (
    SimulatedScan,
    SimulationConfig,
    simulate_scans,
    simulate_sequence,
)
from salpcc.stages.lattice.lattice import unproject
from salpcc.stages.lattice.sensor_model import SensorModel, load_sensor
from salpcc.stages.lattice.untwist import twist, untwist

FAST = SimulationConfig(scans=5, seed=7, speed_mps=16.0, movers=8)
BRIEF = replace(FAST, scans=2)


def some_lasers(sensor: SensorModel, every: int) -> SensorModel:
    """A sensor with fewer lasers."""
    fields = ("theta", "z0", "h", "phi0", "d0", "shift")
    return replace(sensor, name=f"every {every}", **{f: getattr(sensor, f)[::every] for f in fields})


@pytest.fixture(scope="module")
def sensor() -> SensorModel:
    return load_sensor("hdl64e")


@pytest.fixture(scope="module")
def scans(sensor: SensorModel) -> list[SimulatedScan]:
    return list(simulate_scans(FAST, sensor))


def test_raw_points_lie_on_the_lattice(scans: list[SimulatedScan], sensor: SensorModel) -> None:
    for scan in scans:
        millimetres = np.rint(scan.raw.astype(np.float64) * 1000)
        assert np.array_equal((millimetres / 1000).astype(np.float32), scan.raw)
        off = millimetres - np.rint(unproject(sensor, scan.laser, scan.tick, scan.count) * 1000)
        assert np.abs(off).max() <= 1
        assert 0.0005 < (off != 0).any(axis=1).mean() < 0.01


def test_all_lasers_share_the_firing_ticks(scans: list[SimulatedScan], sensor: SensorModel) -> None:
    for scan in scans:
        firing = (scan.tick - sensor.shift[scan.laser]) % sensor.ticks_per_turn
        ticks, uses = np.unique(firing, return_counts=True)
        steps = np.diff(np.append(ticks, ticks[0] + sensor.ticks_per_turn))
        assert 2100 < len(ticks) < 2200
        assert (uses > 10).all()
        assert np.isin(steps, (1, 2)).sum() >= len(steps) - 1
        assert 0.1 < (steps == 1).mean() < 0.2


def test_file_order_is_ring_by_ring_with_rising_azimuth(
    scans: list[SimulatedScan], sensor: SensorModel
) -> None:
    for scan in scans:
        ring = np.diff(scan.laser.astype(int))
        assert set(np.unique(ring)) == {0, 1}
        model = unproject(sensor, scan.laser, scan.tick, scan.count)
        azimuth = np.arctan2(model[:, 1], model[:, 0]) % (2 * np.pi)
        assert (np.diff(azimuth)[ring == 0] >= 0).all()


def test_counts_look_like_a_real_scan(scans: list[SimulatedScan]) -> None:
    for scan in scans:
        assert 105_000 < len(scan) < 128_000
        assert np.array_equal(scan.intensity, (np.rint(scan.intensity * 100.0) / 100.0).astype(np.float32))
        assert scan.intensity.min() == 0 and 0.9 < scan.intensity.max() <= 1
        names = np.array([c.name for c in CLASSES])
        share = dict(zip(names, np.bincount(classes_of_labels(scan.labels), minlength=len(names)) / len(scan),
                         strict=True))  # fmt: skip
        assert 0.15 < share["road"] < 0.45
        assert 0.05 < share["vegetation"] < 0.40
        assert 0.0 < share["unlabelled"] < 0.08
        assert share["building"] + share["fence"] > 0.01
        assert 0.15 < scan.intensity[(scan.labels & 0xFFFF) == 40].mean() < 0.35


def test_movers_carry_moving_labels_and_instances(scans: list[SimulatedScan]) -> None:
    ids, instances = scans[0].labels & 0xFFFF, scans[0].labels >> 16
    moving = np.isin(ids, (252, 253, 254, 255, 257, 258))
    assert moving.any()
    assert (instances[moving] > 0).all()
    assert len(np.unique(instances[moving])) >= 2
    assert (instances[ids == 40] == 0).all()
    for instance in np.unique(instances[instances > 0]):
        assert len(np.unique(ids[instances == instance])) == 1


def test_far_points_are_unlabelled(scans: list[SimulatedScan]) -> None:
    distance = np.linalg.norm(scans[0].raw, axis=1)
    assert (scans[0].labels[distance > FAST.label_range] == 0).all()
    assert (scans[0].labels[distance < FAST.label_range - 0.1] != 0).all()


def test_points_are_the_raw_ones_moved_and_come_back(scans: list[SimulatedScan]) -> None:
    for scan in scans:
        moved = twist(scan.raw.astype(np.float64), scan.motion).astype(np.float32)
        assert np.array_equal(moved, scan.points)
        assert scan.motion[0] == pytest.approx(-FAST.speed_mps * FAST.period_s, rel=0.2)
        found, _, _, explained = untwist(scan.points, scan.motion)
        wrong = (found != np.rint(scan.raw.astype(np.float64) * 1000)).any(axis=1)
        assert wrong.mean() < 1e-3
        assert explained.mean() > 0.999


def test_compensation_puts_static_things_in_one_place(scans: list[SimulatedScan]) -> None:
    def misfit(kind: str) -> float:
        clouds = []
        for scan in (scans[0], scans[-1]):
            upright = np.isin(scan.labels & 0xFFFF, (71, 80)) & (np.linalg.norm(scan.raw, axis=1) < 25)
            points = getattr(scan, kind)[upright].astype(np.float64)
            clouds.append((points @ scan.pose[:3, :3].T + scan.pose[:3, 3])[:, :2])
        return float(np.median(cKDTree(clouds[1]).query(clouds[0])[0]))

    assert misfit("points") < 0.04
    assert misfit("points") < 0.7 * misfit("raw")


def test_a_standing_car_needs_no_compensation(sensor: SensorModel) -> None:
    scan = next(simulate_scans(replace(FAST, scans=1, speed_mps=0.0), some_lasers(sensor, 8)))
    assert np.array_equal(scan.points, scan.raw)
    assert np.abs(scan.motion).max() == 0


def test_one_seed_gives_one_drive_and_another_seed_another(sensor: SensorModel) -> None:
    few = some_lasers(sensor, 16)
    first, again = (list(simulate_scans(BRIEF, few)) for _ in range(2))
    for a, b in zip(first, again, strict=True):
        assert a.points.tobytes() == b.points.tobytes()
        assert a.intensity.tobytes() == b.intensity.tobytes()
        assert a.labels.tobytes() == b.labels.tobytes()
    other = next(simulate_scans(replace(FAST, seed=8), few))
    assert other.points.tobytes() != first[0].points.tobytes()
    assert set(np.unique(first[0].laser)) <= set(range(few.n_lasers))


def test_sequence_is_laid_out_like_semantickitti(tmp_path: Path, sensor: SensorModel) -> None:
    few, told = some_lasers(sensor, 16), []
    simulate_sequence(replace(BRIEF, sequence="21"), tmp_path, few, lambda done, of: told.append((done, of)))
    folder = tmp_path / "sequences" / "21"
    assert sorted(p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file()) == [
        "calib.txt", "labels/000000.label", "labels/000001.label", "poses.txt", "times.txt",
        "velodyne/000000.bin", "velodyne/000001.bin",
    ]  # fmt: skip
    assert told == [(1, 2), (2, 2)]
    scans = list(simulate_scans(BRIEF, few))
    for scan in scans:
        table = np.fromfile(folder / f"velodyne/{scan.number:06d}.bin", "<f4").reshape(-1, 4)
        assert np.array_equal(table[:, :3], scan.points) and np.array_equal(table[:, 3], scan.intensity)
        labels = np.fromfile(folder / f"labels/{scan.number:06d}.label", "<u4")
        assert np.array_equal(labels, scan.labels)
    calib = dict(line.split(": ") for line in (folder / "calib.txt").read_text().splitlines())
    assert list(calib) == ["P0", "P1", "P2", "P3", "Tr"]
    assert all(len(v.split()) == 12 for v in calib.values())
    tr = np.vstack([np.array(calib["Tr"].split(), float).reshape(3, 4), [0, 0, 0, 1]])
    poses = [np.vstack([p.reshape(3, 4), [0, 0, 0, 1]]) for p in np.loadtxt(folder / "poses.txt")]
    assert np.allclose(poses[0], np.eye(4), atol=1e-8)
    step = np.linalg.inv(tr) @ poses[1] @ tr
    assert np.allclose(step, np.linalg.inv(scans[0].pose) @ scans[1].pose, atol=1e-6)
    assert np.allclose(step[:3, 3], -scans[0].motion[:3], atol=0.05)
    assert np.loadtxt(folder / "times.txt") == pytest.approx([0.0, FAST.period_s])


@pytest.mark.parametrize(
    "wrong", [{"scans": 0}, {"scene": "moon"}, {"speed_mps": -1.0}, {"movers": -1}, {"ticks_per_firing": 0.5}]
)
def test_impossible_drives_are_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(UsageError, match="simulation 00"):
        replace(SimulationConfig(), **wrong)  # type: ignore[arg-type]


def test_streets_of_large_vehicles_have_many_of_many_kinds(sensor: SensorModel) -> None:
    large = replace(BRIEF, scans=1, large=0.8, parked=0.8)
    labels = np.concatenate([scan.labels for scan in simulate_scans(large, sensor)])
    usual = np.concatenate([scan.labels for scan in simulate_scans(replace(BRIEF, scans=1), sensor)])
    kinds = (13, 16, 18, 20, 256, 257, 258, 259)
    share = [np.isin(one & 0xFFFF, kinds).mean() for one in (labels, usual)]
    assert share[0] > 5 * share[1]
    assert len(np.unique(labels[np.isin(labels & 0xFFFF, kinds)] & 0xFFFF)) >= 3


def test_streets_of_walls_and_garages_name_each_of_them(sensor: SensorModel) -> None:
    beside = replace(BRIEF, scans=1, parked=0.1, beside=0.8)
    (scan,) = simulate_scans(beside, sensor)
    kinds = scan.labels & 0xFFFF
    things = np.unique(scan.labels[np.isin(kinds, (50, 51, 81)) & (scan.labels >> 16 > 0)])
    assert len(things) >= 5 and len(np.unique(things & 0xFFFF)) >= 2
    assert not (scan.labels[np.isin(kinds, (40, 48, 70, 72))] >> 16).any()
