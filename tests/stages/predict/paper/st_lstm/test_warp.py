"""Warped range images against scenes whose ranges are known."""

import numpy as np
import pytest

from salpcc.schemas.grid import COLUMNS, ROWS
from salpcc.stages.predict.paper.motion import rotation
from salpcc.stages.predict.paper.st_lstm.warp import CENTRES, COVERED, NOTHING, after, pose_of, warp

AZIMUTH = (1.0 - 2.0 * (np.arange(COLUMNS) + 0.5) / COLUMNS) * np.pi
BEAMS = np.stack(
    [
        np.cos(CENTRES)[:, None] * np.cos(AZIMUTH),
        np.cos(CENTRES)[:, None] * np.sin(AZIMUTH),
        np.broadcast_to(np.sin(CENTRES)[:, None], (ROWS, COLUMNS)),
    ],
    axis=2,
)


def room(turn: np.ndarray, way: np.ndarray) -> np.ndarray:
    """Ranges (mm) of a room of 40 x 24 m with a floor, seen from where ``P' = turn P + way`` takes the origin."""
    beams = BEAMS @ turn  # directions in the room's frame
    eye = -turn.T @ way
    found = np.full((ROWS, COLUMNS), np.inf)
    for normal, distance in (
        ((1, 0, 0), 20.0),
        ((-1, 0, 0), 20.0),
        ((0, 1, 0), 12.0),
        ((0, -1, 0), 12.0),
        ((0, 0, -1), 1.7),
    ):
        slope = beams @ np.array(normal, float)
        with np.errstate(divide="ignore"):
            reach = (distance - np.dot(normal, eye)) / slope
        found = np.where((slope > 1e-9) & (reach < found), reach, found)
    return np.rint(found * 1000).astype(np.int32)


STILL = np.eye(3), np.zeros(3)


def test_without_motion_nothing_moves() -> None:
    image = room(*STILL)
    warped, status = warp(image, pose_of(np.zeros(6)))
    assert (np.abs(warped - image) <= 1).all()
    assert (status[1:-1] == COVERED).mean() > 0.95


@pytest.mark.parametrize("motion", [[-1.2, 0.05, -0.02, 1e-3, -2e-3, 0.04], [0.4, -0.3, 0.0, 0.0, 0.0, -0.3]])
def test_a_room_is_seen_from_where_the_sensor_went(motion: list[float]) -> None:
    m = np.array(motion)
    expected = room(rotation(m[3:]), m[:3])
    warped, status = warp(room(*STILL), pose_of(m))
    off = np.abs(warped - expected)[status == COVERED]
    assert (status == COVERED).mean() > 0.9
    assert np.quantile(off, 0.95) < 10  # mm; cells at the room's edges see across them
    before = np.abs(room(*STILL) - expected)[status == COVERED]
    assert np.mean(off) * 5 < np.mean(before)


def test_two_motions_are_one() -> None:
    first, second = np.array([-1.0, 0.1, 0, 0, 0.01, 0.05]), np.array([-0.8, 0, 0.02, 0.02, 0, -0.1])
    point = np.array([3.0, -2.0, 1.0])
    once = pose_of(first)[:, :3] @ point + pose_of(first)[:, 3]
    twice = pose_of(second)[:, :3] @ once + pose_of(second)[:, 3]
    both = after(pose_of(second), pose_of(first))
    np.testing.assert_allclose(both[:, :3] @ point + both[:, 3], twice, atol=1e-12)


def test_the_nearer_surface_hides_the_farther() -> None:
    image = np.full((ROWS, COLUMNS), 20_000, np.int32)
    image[:, 900:1000] = 5_000  # a post ahead and to the left; driving on, it widens
    warped, _ = warp(image, pose_of(np.array([-1.0, 0, 0, 0, 0, 0])))
    assert set(np.unique(np.round(warped[20] / 1000)).astype(int)) <= {4, 5, 6, 19, 20, 21}
    assert (warped[20, 880:1000] < 6_000).sum() > 100


def test_empty_and_single_returns() -> None:
    nothing, status = warp(np.zeros((ROWS, COLUMNS), np.int32), pose_of(np.zeros(6)))
    assert not nothing.any() and (status == NOTHING).all()
    image = np.zeros((ROWS, COLUMNS), np.int32)
    image[30, 0] = 8_000
    warped, _ = warp(image, pose_of(np.zeros(6)))
    assert warped[30, 0] == 8_000
    assert warped[30, COLUMNS - 3] == 8_000  # holes near it take its range, around the seam
    assert warped[50, 1000] == 0
