"""De-skewing: a wall that a moving sensor saw is straight again; times of points count where they have any."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from salpcc.schemas.log import LogMessage
from salpcc.schemas.messages import CloudMessage
from salpcc.schemas.scan import Scan
from salpcc.stages.ingest.point_cloud import message_to_scan
from salpcc.stages.mapping.drive.deskew import deskewed, motion_of, motions_of, step_of, turns_before
from salpcc.stages.mapping.drive.poses import inverse, move

TURN = 100_000_000  # nanoseconds
STEP = np.eye(4)
STEP[:3, :3] = Rotation.from_rotvec([0.0, 0.01, 0.05]).as_matrix()
STEP[:3, 3] = 1.5, 0.1, 0.02


def seen(after: np.ndarray, wall: np.ndarray) -> np.ndarray:
    """Points ``(N, 3)`` of the world, each as the sensor saw it ``after`` turns."""
    motion = motion_of(STEP, 1)
    return np.array([move(p[None], inverse(step_of(motion, t)))[0] for p, t in zip(wall, after, strict=True)])


@pytest.fixture(scope="module")
def wall() -> np.ndarray:
    azimuth = np.linspace(-3.1, 3.1, 400)
    return np.column_stack([20 * np.cos(azimuth), 20 * np.sin(azimuth), np.linspace(-2, 3, 400)])


def test_a_step_is_its_motion() -> None:
    np.testing.assert_allclose(step_of(motion_of(STEP, 2), 2), STEP, atol=1e-12)


def test_a_turn_is_seen_from_one_place(wall: np.ndarray) -> None:
    """The sensor turns clockwise, and looks ahead at the instant of its pose."""
    after = -np.arctan2(wall[:, 1], wall[:, 0]) / (2 * np.pi)
    for _ in range(5):  # when it sees a point depends on where it sees it
        raw = seen(after, wall)
        after = -np.arctan2(raw[:, 1], raw[:, 0]) / (2 * np.pi)
    scan = Scan("0", raw.astype(np.float32), np.zeros(len(raw), np.float32))
    back = deskewed(scan.points, turns_before(scan), motion_of(STEP, 1))
    assert np.abs(raw - wall).max() > 0.5
    # A turn and a way at once are taken one after the other, which is 4 mm at this speed.
    assert np.abs(back - wall).max() < 0.01
    compensated = replace(scan, motion=np.array([1.0, 0, 0, 0, 0, 0]))
    assert not turns_before(compensated).any()


@pytest.mark.parametrize("kind", ["t", "time", "timestamp"])
def test_times_of_points_are_believed(wall: np.ndarray, kind: str) -> None:
    """Nanoseconds from the stamp, seconds from the stamp, seconds of the clock: whatever the azimuth says."""
    stamp = 1_700_000_000 * 10**9
    after = np.linspace(0.0, 1.0, len(wall))
    values, code = {
        "t": (np.rint(TURN * after).astype("<u4"), 6),
        "time": ((1e-9 * TURN * after).astype("<f4"), 7),
        "timestamp": (1e-9 * (stamp + TURN * after), 8),
    }[kind]
    row = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), (kind, values.dtype)])
    rows = np.empty(len(wall), row)
    for axis, name in enumerate("xyz"):
        rows[name] = seen(after, wall)[:, axis]
    rows[kind] = values
    fields = (("x", 0, 7, 1), ("y", 4, 7, 1), ("z", 8, 7, 1), (kind, 12, code, 1))
    message = CloudMessage(stamp, "lidar", len(rows), rows.tobytes(), point_step=row.itemsize, fields=fields)
    logged = LogMessage(1, stamp, stamp, 0, message.to_cdr())
    scan = message_to_scan(logged, "cdr", "/points", "0")
    np.testing.assert_allclose(turns_before(scan), -after, atol=1e-5)
    assert np.abs(deskewed(scan.points, turns_before(scan), motion_of(STEP, 1)) - wall).max() < 0.02


def test_the_motion_is_that_of_the_poses_around() -> None:
    poses = [np.eye(4)]
    for _ in range(4):
        poses.append(poses[-1] @ STEP)
    numbers = [0, 1, 2, 3, 40]  # the last is another time
    motions = motions_of(np.array(poses), numbers)
    np.testing.assert_allclose(motions[:4], np.tile(motion_of(STEP, 1), (4, 1)), atol=1e-12)
    assert not motions[4].any()
