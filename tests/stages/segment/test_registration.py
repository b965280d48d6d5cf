"""Registration: the motion between two scans is found again, and where there is none to be found it is not made up."""

import numpy as np
import pytest

from salpcc.schemas.labels import OTHER
from salpcc.stages.segment.network.projection import project
from salpcc.stages.segment.registration import as_pose, steps_between
from salpcc.stages.segment.segmenter import Segmentation


def _rays() -> np.ndarray:
    azimuth = np.pi * (1 - 2 * (np.arange(2048) + 0.5) / 2048)
    elevation = np.deg2rad(np.linspace(1.5, -24.0, 64))[:, None]
    return np.stack(
        [
            np.cos(elevation) * np.cos(azimuth),
            np.cos(elevation) * np.sin(azimuth),
            np.sin(elevation) + 0 * azimuth,
        ],
        -1,
    ).reshape(-1, 3)


def _room(pose: np.ndarray) -> np.ndarray:
    """What a sensor sees of a street with a floor, two house fronts with bays, and both ends, from ``pose`` (into the street)."""
    rays = _rays() @ pose[:3, :3].T
    origin = pose[:3, 3]
    shortest = np.full(len(rays), 80.0)
    planes = [((0, 0, 1), -1.7), ((0, 1, 0), 9.0), ((0, 1, 0), -7.0), ((1, 0, 0), 30.0), ((1, 0, 0), -25.0)]
    planes += [((1, 0, 0), float(x)) for x in range(-20, 28, 6)]
    with np.errstate(divide="ignore", invalid="ignore"):
        for normal, offset in planes:
            along = (offset - origin @ normal) / (rays @ np.array(normal, float))
            at = origin + rays * along[:, None]
            bay = normal == (1, 0, 0) and -25 < offset < 30
            there = (along > 0) & (~bay | (np.abs(at[:, 1] - 1.0) > 6.5))
            shortest = np.where(there & (along < shortest), along, shortest)
    seen = shortest < 80
    return (_rays()[seen] * shortest[seen, None]).astype(np.float32)


def _segmentation(points: np.ndarray) -> Segmentation:
    image = project(points, np.full(len(points), 0.3, np.float32))
    groups = np.zeros((3, *image.index.shape), np.float32)
    groups[OTHER] = image.index >= 0
    return Segmentation(image, groups, np.zeros_like(groups, np.uint8))


AHEAD = np.array([-1.3, 0.03, 0.01, 0.002, -0.003, 0.02])


@pytest.fixture(scope="module")
def drive() -> list[Segmentation]:
    place = np.eye(4)
    scans = []
    for _ in range(3):
        scans.append(_segmentation(_room(place)))
        place = place @ np.linalg.inv(as_pose(AHEAD))
    return scans


@pytest.mark.parametrize("given", [None, AHEAD + np.array([0.2, 0.05, 0, 0, 0, 0.01])])
def test_the_motion_is_found_from_nothing_and_from_a_guess(drive: list[Segmentation], given) -> None:
    steps = steps_between(drive, [False, True, True], [given] * 3)
    assert steps[0] is None
    for step in steps[1:]:
        assert np.abs(step[:3, 3] - AHEAD[:3]).max() < 0.03
        assert np.abs(step[:3, :3] - as_pose(AHEAD)[:3, :3]).max() < 0.003


def test_nothing_is_found_over_a_gap_or_between_strangers(drive: list[Segmentation]) -> None:
    assert steps_between(drive, [False, True, False], [None] * 3)[2] is None
    rng = np.random.default_rng(0)
    noise = _segmentation((_rays() * rng.uniform(3, 60, (len(_rays()), 1))).astype(np.float32))
    assert steps_between([drive[0], noise], [False, True], [None, None])[1] is None
    known = steps_between([drive[0], noise], [False, True], [None, AHEAD])[1]
    assert np.allclose(known, as_pose(AHEAD))


def test_an_empty_scan_has_no_motion(drive: list[Segmentation]) -> None:
    empty = _segmentation(np.zeros((0, 3), np.float32))
    assert steps_between([empty, drive[0], empty], [False, True, True], [None] * 3) == [None, None, None]
