"""Movers are pasted where their rays meet them, and a setting that takes them is preferred to one that takes what stands."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from salpcc.schemas.scan import Scan
from salpcc.stages.mapping.config import Carving, MapConfig
from salpcc.stages.mapping.drive.deskew import fastest
from salpcc.stages.mapping.paste import Mover, ground_under, movers_of, paste
from salpcc.stages.mapping.tune import STRETCH, Trial, best, tune

F64 = NDArray[np.float64]


def room(lowest: float = -24.0) -> F64:
    """A scan of a round wall 20 m away and the ground 1.7 m below, from ``lowest`` degrees up."""
    azimuth, elevation = np.meshgrid(
        np.linspace(-np.pi, np.pi, 1200, endpoint=False), np.radians(np.arange(lowest, 3, 0.5))
    )
    ahead = np.stack([np.cos(azimuth), np.sin(azimuth), np.tan(elevation)], axis=-1).reshape(-1, 3)
    with np.errstate(divide="ignore"):
        reach = np.where(ahead[:, 2] < 0, np.minimum(20.0, -1.7 / ahead[:, 2]), 20.0)
    return np.asarray(ahead * reach[:, None])


def test_rays_end_on_the_side_of_a_box_that_they_meet_first() -> None:
    points, pose = room(), np.eye(4)
    pose[:3, 3] = 5, -2, 1  # wherever that is in the map
    at = pose.copy()
    at[:3, 3] += 10, 0, -1.7
    box = Mover((2.0, 4.0, 1.5), at[None])
    moved, hit = paste(points, pose, [box], 0)
    assert hit.sum() > 200
    np.testing.assert_array_equal(moved[~hit], points[~hit])
    np.testing.assert_allclose(moved[hit, 0].min(), 9.0, atol=1e-9)  # the front
    assert (np.abs(moved[hit, 1]) <= 2 + 1e-9).all() and (moved[hit, 2] <= -0.2 + 1e-9).all()
    along = np.cross(moved[hit], points[hit])
    assert np.abs(along).max() < 1e-9  # on their rays
    assert (np.linalg.norm(moved[hit], axis=1) < np.linalg.norm(points[hit], axis=1)).all()
    assert not paste(points, pose, [Mover((2.0, 4.0, 1.5), pose[None])], 0)[
        1
    ].any()  # nothing stands in the sensor
    assert abs(ground_under(points) + 1.7) < 0.05


def test_movers_move_on_the_ground_beside_the_way() -> None:
    poses = np.tile(np.eye(4), (6, 1, 1))
    poses[:, 0, 3] = np.arange(6)
    movers = movers_of(poses, -1.7, 8, 3)
    assert len(movers) == 8
    for mover in movers:
        steps = np.linalg.norm(np.diff(mover.poses[:, :3, 3], axis=0), axis=1)
        assert np.allclose(steps, steps[0]) and 0.1 < steps[0] < 1.0
        assert np.allclose(mover.poses[:, 2, 3], -1.7)


def test_settings_are_scored_by_what_stays_and_what_goes() -> None:
    points = room(-9.0).astype(np.float32)
    scans = [Scan(f"{k:06d}", points, np.zeros(len(points), np.float32)) for k in range(7)]
    poses = np.tile(np.eye(4), (7, 1, 1))  # views are taken on the way, so it drives, but sees the same
    poses[:, 0, 3] = 0.8 * np.arange(7)
    scans = [
        replace(scan, points=(points - pose[:3, 3]).astype(np.float32))
        for scan, pose in zip(scans, poses, strict=True)
    ]
    config = MapConfig.model_validate({"voxel": 0.2, "max_range": 40})
    trials = tune(scans, poses, np.zeros((7, 6)), config)
    assert len(trials) == 18 and [t.aa for t in trials] == sorted((t.aa for t in trials), reverse=True)
    assert trials[0].sa > 0.97 and trials[0].da > 0.3 and trials[0].da > 2 * trials[-1].da
    assert tune(scans, poses, np.zeros((7, 6)), config) == trials  # seeded


def test_the_setting_in_hand_stays_where_it_is_hardly_worse() -> None:
    usual, other = Carving.model_validate({}), Carving(views=3, per_meeting=1.0, margin=0.6)
    assert best([Trial(other, 0.9905, 0.9905), Trial(usual, 0.99, 0.99)], usual) == usual
    assert best([Trial(other, 0.995, 0.995), Trial(usual, 0.99, 0.99)], usual) == other
    assert best([], usual) == usual


def test_it_is_tuned_where_one_drove_farthest() -> None:
    motions = np.zeros((100, 6))
    motions[55:90, 0] = 1.0
    part = fastest(motions, STRETCH)
    assert part.stop - part.start == STRETCH and motions[part, 0].sum() == 35
    assert fastest(np.zeros((5, 6)), STRETCH) == slice(0, 5)
