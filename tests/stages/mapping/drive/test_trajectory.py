"""Poses with times: read as TUM and EuRoC write them, interpolated, and refused where they do not cover the scans."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from salpcc.schemas.errors import SourceError
from salpcc.stages.mapping.drive.pose_files import read_trajectory
from salpcc.stages.mapping.drive.trajectory import Trajectory

SECOND = 10**9
START = 1_600_000_000 * SECOND


def circle(times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Places and quaternions of a slow turn about z while one climbs, at times in seconds."""
    places = np.column_stack([3.0 * times, -times, 0.5 * times])
    return places, Rotation.from_rotvec(np.outer(0.4 * times, [0, 0, 1])).as_quat()


def test_poses_in_between_are_on_the_line_and_the_arc() -> None:
    seconds = np.arange(0, 3, 0.5)
    order = np.random.default_rng(0).permutation(len(seconds))
    places, turns = circle(seconds)
    times = START + (seconds * SECOND).astype(np.int64)
    trajectory = Trajectory.of("t", times[order], places[order], -turns[order])  # of either sign
    wanted = np.array([0.0, 0.3, 1.25, 2.5])
    found = trajectory.at([START + int(t * SECOND) for t in wanted], list("abcd"))
    places, turns = circle(wanted)
    np.testing.assert_allclose(found[:, :3, 3], places, atol=1e-9)
    np.testing.assert_allclose(found[:, :3, :3], Rotation.from_quat(turns).as_matrix(), atol=1e-9)


def test_what_is_not_covered_is_named() -> None:
    places, turns = circle(np.array([0.0, 0.5, 4.0]))
    trajectory = Trajectory.of("t", [START, START + SECOND // 2, START + 4 * SECOND], places, turns)
    a_little = START - 5_000_000  # five milliseconds before: rounded elsewhere, and its first pose
    assert np.allclose(trajectory.at([a_little], ["first"])[0, :3, 3], places[0])
    says = r"t: poses from 1600000000.000 to 1600000004.000 s, 1 of 2 scans are not in between, such as b at 0.000 s"
    with pytest.raises(SourceError, match=says):
        trajectory.at([START, 0], ["a", "b"])
    with pytest.raises(SourceError, match=r"scan b at 1600000002.000 s lies between poses 3.5 s apart"):
        trajectory.at([START, START + 2 * SECOND], ["a", "b"])
    np.testing.assert_allclose(trajectory.at([START + 4 * SECOND], ["end of a gap"])[0, :3, 3], places[2])
    for bad in (np.full((3, 3), np.nan), places):
        with pytest.raises(SourceError, match=r"pose [12] is none"):
            Trajectory.of("t", [1, 2, 3], bad, turns * [[1], [1e-3], [1]])
    with pytest.raises(SourceError, match="no pose in it"):
        Trajectory.of("t", [], np.empty((0, 3)), np.empty((0, 4)))


def test_tum_and_euroc_are_told_apart_by_their_lines(tmp_path: Path) -> None:
    seconds = np.arange(4) / 10
    places, turns = circle(seconds)
    stamps = [START + 123_456_789 + k * 100_000_000 for k in range(4)]
    tum = "\n".join(
        f"{t // SECOND}.{t % SECOND:09d} " + " ".join(f"{v:.12f}" for v in (*p, *q))
        for t, p, q in zip(stamps, places, turns, strict=True)
    )
    (tmp_path / "tum.txt").write_text(f"# timestamp tx ty tz qx qy qz qw\n\n{tum}\n")
    wxyz = turns[:, [3, 0, 1, 2]]
    for name, more in (("euroc.csv", ""), ("truth.csv", ",0" * 9)):
        rows = [
            f"{t}," + ",".join(f"{v:.12f}" for v in (*p, *q)) + more
            for t, p, q in zip(stamps, places, wxyz, strict=True)
        ]
        (tmp_path / name).write_text("#timestamp [ns], p_RS_R_x [m], …\n" + "\n".join(rows) + "\n")
    found = [read_trajectory(tmp_path / name) for name in ("tum.txt", "euroc.csv", "truth.csv")]
    for trajectory in found:
        assert trajectory is not None and trajectory.times.tolist() == stamps  # to the nanosecond
        np.testing.assert_allclose(trajectory.poses[:, :3, 3], places, atol=1e-9)
        np.testing.assert_allclose(
            trajectory.poses[:, :3, :3], Rotation.from_quat(turns).as_matrix(), atol=1e-9
        )
    (tmp_path / "kitti.txt").write_text("1 0 0 0 0 1 0 0 0 0 1 0\n")
    assert read_trajectory(tmp_path / "kitti.txt") is None


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("1 0 0 0 0 0 0 1\n2 0 0 0 0 0 1\n", "line 2: 7 numbers, the first one has 8"),
        ("1 0 0 0 0 0 0 1\n# so\n2 0 0 x 0 0 0 1\n", "line 3: not all of it are numbers"),
        ("nan 0 0 0 0 0 0 1\n", "line 1: not all of it are numbers"),
        ("1 0 0 0 0 0 0 0\n", "pose 1 is none"),
    ],
)
def test_bad_lines_are_named(tmp_path: Path, text: str, says: str) -> None:
    (tmp_path / "poses.tum").write_text(text)
    with pytest.raises(SourceError, match=says):
        read_trajectory(tmp_path / "poses.tum")
