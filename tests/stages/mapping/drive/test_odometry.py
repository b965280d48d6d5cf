"""Odometry goes on past scans of few points; scans that a driver moved already are known by how they fit one another."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray

from salpcc.stages.ingest.simulator import SimulationConfig, simulate_sequence
from salpcc.stages.ingest.sources import SOURCES
from salpcc.stages.lattice.sensor_model import load_sensor
from salpcc.stages.mapping.drive.deskew import deskewed, motion_of, step_of
from salpcc.stages.mapping.drive.moved_already import moved_already
from salpcc.stages.mapping.drive.odometry import Thinned, follow, thin
from salpcc.stages.mapping.drive.poses import inverse, read_poses

F64 = NDArray[np.float64]
SCANS = 8


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> tuple[list[F64], F64]:
    """Compensated scans of a drive, and the motion per turn of each."""
    out = tmp_path_factory.mktemp("drive")
    config = SimulationConfig(sequence="00", scans=SCANS, seed=3, scene="city", movers=0, speed_mps=12.0)
    simulate_sequence(config, out, load_sensor("hdl64e"))
    points = [SOURCES["simulated"].read(r, False).points for r in SOURCES["simulated"].scans(out, "00")]
    poses = read_poses(out / "sequences" / "00" / "poses.txt")
    steps = [motion_of(inverse(a) @ b, 1) for a, b in pairwise(poses)]
    return [p.astype(np.float64) for p in points], np.array([*steps, steps[-1]])


def clouds(points: list[F64]) -> list[Thinned]:
    """Scans that tell no motion, their times by azimuth."""
    out = []
    for k, xyz in enumerate(points):
        xyz = xyz[np.linalg.norm(xyz, axis=1) > 2.0]
        out.append(Thinned(k, *thin(xyz, before_of(xyz)), None))
    return out


def before_of(xyz: F64) -> F64:
    return np.asarray(np.arctan2(xyz[:, 1], xyz[:, 0]) / (2 * np.pi))


def verdict(scans: list[Thinned]) -> bool:
    return moved_already([lambda s=s: s for s in scans], list(follow(scans)), range(len(scans)))


def test_compensated_scans_are_known_and_raw_ones_too(drive: tuple[list[F64], F64]) -> None:
    points, motions = drive
    assert verdict(clouds(points))
    raw = [deskewed(xyz, before_of(xyz), -m) for xyz, m in zip(points, motions, strict=True)]
    assert not verdict(clouds(raw))


def test_who_stands_is_left_as_it_is(drive: tuple[list[F64], F64]) -> None:
    assert not verdict(clouds([drive[0][0]] * 3))


def test_covered_scans_stand_on_the_way(drive: tuple[list[F64], F64]) -> None:
    """A sensor that sees nothing for a moment, at the start, in the middle and at the end, stops no odometry."""
    points, motions = drive
    covered = {0, 3, 4, SCANS - 1}
    scans = [
        replace(cloud, points=cloud.points[:9], before=cloud.before[:9]) if k in covered else cloud
        for k, cloud in enumerate(replace(c, motion=m) for c, m in zip(clouds(points), motions, strict=True))
    ]
    found = list(follow(scans))
    assert [scan.good for scan in found] == [True] * SCANS
    way = np.eye(4)
    for k in range(1, SCANS - 1):
        assert np.linalg.norm(found[k].pose[:3, 3] - way[:3, 3]) < 0.05 * k
        way = way @ step_of(motions[k], 1)
    assert np.linalg.norm(found[-1].pose[:3, 3] - way[:3, 3]) < 0.5
    assert [scan.good for scan in follow([scans[0]] * 2)] == [False] * 2
