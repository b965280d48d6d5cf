"""Refinement: what given poses lack is found, what they know is kept, and right ones are left."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from salpcc.stages.mapping.drive.odometry import Thinned, thin
from salpcc.stages.mapping.drive.poses import inverse, move
from salpcc.stages.mapping.drive.refine import candidates, choose, residual, spots_of


def drive(n: int, step: float = 1.0, bend: float = 0.004) -> np.ndarray:
    poses = [np.eye(4)]
    turn = np.eye(4)
    turn[:3, :3] = Rotation.from_rotvec([0, 0, bend]).as_matrix()
    turn[0, 3] = step
    for _ in range(n - 1):
        poses.append(poses[-1] @ turn)
    return np.array(poses)


def test_a_scale_that_is_off_is_taken_out() -> None:
    truth = drive(60)
    given = truth.copy()
    given[:, :3, 3] *= 1.04
    ways, scale = candidates(truth, given)
    assert scale == pytest.approx(1.04, abs=1e-6)
    np.testing.assert_allclose(ways["spread"], truth, atol=1e-6)
    np.testing.assert_allclose(ways["laid"], truth, atol=1e-6)


def test_drift_is_spread_and_jitter_is_not_taken_over() -> None:
    """Registration that bends away is led back to the given poses; noise of these from scan to scan is left out."""
    truth, found = drive(400), drive(400, bend=0.0042)
    rng = np.random.default_rng(0)
    given = truth.copy()
    given[:, :3, 3] += rng.normal(0, 0.05, (400, 3))
    assert np.linalg.norm(found[-1, :3, 3] - truth[-1, :3, 3]) > 10
    ways, scale = candidates(found, given)
    assert abs(scale - 1) < 0.01
    off = np.linalg.norm(ways["spread"][:, :3, 3] - truth[:, :3, 3], axis=1)
    assert off.max() < 1.0
    steps = np.linalg.norm(np.diff(ways["spread"][:, :3, 3], axis=0), axis=1)
    assert np.abs(steps - 1.0).max() < 0.02


def test_standing_has_no_scale() -> None:
    still = np.tile(np.eye(4), (5, 1, 1))
    ways, scale = candidates(still, still)
    assert scale == 1.0
    np.testing.assert_allclose(ways["spread"], still, atol=1e-9)


def test_the_most_faithful_of_those_that_fit_is_taken() -> None:
    assert choose({"given": 0.020, "spread": 0.019, "laid": 0.019}) == "given"
    assert choose({"given": 0.040, "spread": 0.0202, "laid": 0.020}) == "spread"
    assert choose({"given": 0.040, "spread": 0.030, "laid": 0.020}) == "laid"
    assert choose({"given": None, "spread": None, "laid": None}) == "given"


def test_the_residual_tells_poses_that_fit() -> None:
    rng = np.random.default_rng(1)
    wall = np.column_stack(
        [rng.uniform(-30, 60, 20000), rng.choice([-6.0, 6.0], 20000), rng.uniform(-1, 4, 20000)]
    )
    truth = drive(24, bend=0.0)
    clouds = [
        Thinned(k, *thin(move(wall, inverse(p)), np.zeros(len(wall))), np.zeros(6))
        for k, p in enumerate(truth)
    ]
    wrong = truth.copy()
    wrong[:, 1, 3] += rng.normal(0, 0.1, 24)
    spots, still = spots_of(24), np.zeros((24, 6))
    fits, off = (residual(clouds.__getitem__, spots, poses, still) for poses in (truth, wrong))
    assert fits is not None and off is not None
    assert fits < 0.005 and off > 0.05
    assert residual(clouds.__getitem__, spots_of(1), truth, still) is None
