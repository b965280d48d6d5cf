"""Poses: what is read is what KITTI means, and every way to get them wrong is named."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from salpcc.schemas.errors import SourceError
from salpcc.stages.mapping.drive.poses import inverse, move, poses_of, read_poses

TR = "0 -1 0 0.1 0 0 -1 -0.2 1 0 0 -0.3"


def written(folder: Path, lines: list[str], calib: str | None = f"P0: 1 2 3\nTr: {TR}\n") -> Path:
    (folder / "poses.txt").write_text("\n".join(lines) + "\n")
    if calib is not None:
        (folder / "calib.txt").write_text(calib)
    return folder / "poses.txt"


def test_camera_ahead_is_sensor_ahead(tmp_path: Path) -> None:
    # The camera looks along its z: 2 m ahead there is 2 m along the sensor's x.
    path = written(tmp_path, ["1 0 0 0 0 1 0 0 0 0 1 0", "1 0 0 0 0 1 0 0 0 0 1 2"])
    poses = read_poses(path)
    np.testing.assert_allclose(poses[1, :3, 3], [2, 0, 0], atol=1e-12)
    np.testing.assert_allclose(poses[1, :3, :3], np.eye(3), atol=1e-12)


def test_inverse_undoes_a_pose() -> None:
    angle = 0.3
    pose = np.eye(4)
    pose[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    pose[:3, 3] = 1, 2, 3
    points = np.random.default_rng(0).normal(size=(20, 3))
    np.testing.assert_allclose(move(move(points, pose), inverse(pose)), points, atol=1e-12)


@pytest.mark.parametrize(
    ("lines", "calib", "says"),
    [
        (["1 0 0 0 0 1 0 0 0 0 1"], f"Tr: {TR}", "line 1: 11 numbers"),
        (["1 0 0 0 0 1 0 0 0 0 1 x"], f"Tr: {TR}", "line 1"),
        (["1 0 0 0 0 1 0 0 0 0 1 0"], None, "calib.txt: not found"),
        (["1 0 0 0 0 1 0 0 0 0 1 0"], "P0: 1", "no line `Tr:`"),
        (["1 0 0 0 0 1 0 0 0 0 1 0"], "Tr: 2 0 0 0 0 2 0 0 0 0 2 0", "`Tr:` is not a pose"),
        ([""], f"Tr: {TR}", "no pose in it"),
    ],
)
def test_bad_files_are_named(tmp_path: Path, lines: list[str], calib: str | None, says: str) -> None:
    with pytest.raises(SourceError, match=says):
        read_poses(written(tmp_path, lines, calib))


def test_missing_poses_are_named(tmp_path: Path) -> None:
    with pytest.raises(SourceError, match=r"poses.txt: no poses there.*--poses odometry"):
        read_poses(tmp_path / "poses.txt")


def test_short_and_nan_poses_name_the_scan(tmp_path: Path) -> None:
    good = "1 0 0 0 0 1 0 0 0 0 1 0"
    path = written(tmp_path, [good, good.replace("0 1 0", "nan 1 0"), good])
    poses = read_poses(path)
    assert len(poses_of(["000000", "000002"], poses, path)) == 2
    with pytest.raises(SourceError, match="pose of scan 000001"):
        poses_of(["000000", "000001"], poses, path)
    with pytest.raises(SourceError, match="3 poses, none for scan 000003"):
        poses_of(["000002", "000003"], poses, path)
