"""Registration: errors as the paper defines them; ICP and odometry find a known motion; wrong poses are told."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from salpcc.stages.mapping.drive.agree import agreement
from salpcc.stages.mapping.drive.odometry import Registered, Thinned, follow, thin
from salpcc.stages.mapping.drive.poses import inverse, move
from salpcc.stages.mapping.drive.registration import icp, rotation_error, translation_error


def pose(x: float, y: float = 0.0, degrees: float = 0.0) -> np.ndarray:
    out = np.eye(4)
    out[:3, :3] = Rotation.from_euler("z", degrees, degrees=True).as_matrix()
    out[:3, 3] = x, y, 0
    return out


@pytest.fixture(scope="module")
def street() -> np.ndarray:
    """Ground, two walls and posts, 80 m long."""
    rng = np.random.default_rng(0)
    ground = np.column_stack(
        [rng.uniform(-40, 40, 9000), rng.uniform(-8, 8, 9000), rng.normal(0, 0.01, 9000)]
    )
    walls = np.column_stack(
        [rng.uniform(-40, 40, 9000), rng.choice([-8.0, 8.0], 9000), rng.uniform(0, 5, 9000)]
    )
    walls[:, 1] += 0.8 * (np.sin(1.3 * walls[:, 0]) > 0)
    foot = rng.uniform([-40, -7], [40, 7], (40, 2))
    posts = np.column_stack([np.repeat(foot, 60, axis=0), np.tile(np.linspace(0, 4, 60), 40)])
    return np.concatenate([ground, walls, posts])


def test_errors_are_the_papers() -> None:
    turned = pose(0, 0, 2.0)
    cosine = (np.trace(turned[:3, :3]) - 1) / 2
    assert rotation_error(turned, np.eye(4)) == pytest.approx(np.degrees(np.arccos(cosine)))
    assert rotation_error(pose(1, 0, 5), pose(9, 0, 5)) == pytest.approx(0, abs=1e-9)
    assert translation_error(pose(3, 4), np.eye(4)) == 5.0


@pytest.mark.usefixtures("open3d")
@pytest.mark.parametrize("method", ["point", "plane"])
def test_icp_finds_a_motion(street: np.ndarray, method: str) -> None:
    truth = pose(0.3, 0.05, 0.4)
    found = icp(move(street, inverse(truth)), street, method)  # type: ignore[arg-type]
    assert translation_error(found, truth) < 0.01
    assert rotation_error(found, truth) < 0.02


def cloud(number: int, points: np.ndarray) -> Thinned:
    """A compensated scan that stood still, as far as it knows."""
    return Thinned(number, *thin(points, np.zeros(len(points))), np.zeros(6))


def test_odometry_follows_a_drive(street: np.ndarray) -> None:
    truth = [pose(1.0 * k, 0.02 * k * k, 0.5 * k) for k in range(6)]
    clouds = [cloud(k, move(street, inverse(p))) for k, p in enumerate(truth)]
    found = list(follow(clouds, np.array([pose(0.9 * k) for k in range(6)])))
    assert all(f.good for f in found)
    assert translation_error(found[-1].pose, truth[-1]) < 0.05
    assert rotation_error(found[-1].pose, truth[-1]) < 0.1


def test_odometry_says_where_it_is_lost_and_goes_on_from_there(street: np.ndarray) -> None:
    elsewhere = street[:, [1, 0, 2]] * [3.0, 0.4, 2.0] + [0, 0, 4.0]
    clouds = [cloud(0, street), cloud(1, elsewhere), cloud(2, move(elsewhere, inverse(pose(0.5))))]
    said = np.array([pose(0), pose(7.0), pose(7.4)])
    found = list(follow(clouds, said))
    assert [f.good for f in found] == [True, False, True]
    np.testing.assert_allclose(found[1].pose, said[1])
    assert translation_error(found[2].pose, pose(7.5)) < 0.05


def test_a_long_chain_stays_one_of_rotations(street: np.ndarray) -> None:
    rotations = np.array([f.pose[:3, :3] for f in follow([cloud(k, street) for k in range(30)])])
    assert np.abs(rotations @ rotations.transpose(0, 2, 1) - np.eye(3)).max() < 1e-12


def test_agreement_tells_right_poses_from_others() -> None:
    found = [Registered(pose(0.8 * k), 0.9, True) for k in range(8)]
    right = np.array([pose(10 + 0.82 * k) for k in range(8)])
    faster = np.array([pose(1.3 * k) for k in range(8)])
    turning = np.array([pose(0.8 * k, 0, 0.5 * k) for k in range(8)])
    assert agreement("7", right, found).agree is True
    assert agreement("7", faster, found).agree is False
    assert agreement("7", turning, found).agree is False
    lost = [*found[:-1], Registered(found[-1].pose, 0.2, False)]
    assert agreement("7", faster, lost).agree is None
