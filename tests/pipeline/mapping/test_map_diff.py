"""Two sessions of one street: what is gone, what appeared, what stands elsewhere, and what only one of them saw."""

from __future__ import annotations

import io
import json
from dataclasses import replace
from pathlib import Path

import laspy
import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image
from scipy.spatial.transform import Rotation

from salpcc.pipeline.mapping.map_diff import diff
from salpcc.pipeline.mapping.map_export import to_laz, to_ply
from salpcc.pipeline.mapping.map_frame import Frame
from salpcc.schemas.errors import SourceError, UsageError
from salpcc.schemas.labels import CLASSES
from salpcc.stages.mapping.clusters import objects_of
from salpcc.stages.mapping.drive.poses import move
from salpcc.stages.mapping.voxel import Voxels, fuse

F64 = NDArray[np.float64]
ORIGIN = (500_000.0, 5_400_000.0, 100.0)
CLASS = {c.name: k for k, c in enumerate(CLASSES)}
STEP = 0.1


def block(low: tuple[float, float, float], high: tuple[float, float, float], kind: str) -> Voxels:
    """The surface of a block, as points 0.1 m apart."""
    axes = [np.arange(a, b + STEP / 2, STEP) for a, b in zip(low, high, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    on = (np.isclose(grid, low) | np.isclose(grid, high)).any(axis=1)
    xyz = grid[on] + 0.03
    return Voxels.of_points(xyz, np.full(len(xyz), 0.5, np.float32), np.full(len(xyz), CLASS[kind], np.uint8))


def street(*things: Voxels) -> Voxels:
    """Ground with a house on each side and at the end, and things on it."""
    walls = [
        block((-15, 8, 0), (25, 8.1, 6), "building"),
        block((-15, -8, 0), (25, -7.9, 6), "building"),
        block((25, -8, 0), (25.1, 8, 6), "building"),
        block((-15, -8, -0.1), (25, 8, 0), "road"),
    ]
    return Voxels.together([*walls, *things])


def session(out: Path, voxels: Voxels, pose: F64, form: str = "laz", crs: str | None = None) -> Path:
    """Write what a map is of, moved by ``pose``, with a drive along the street."""
    voxels = fuse(replace(voxels, xyz=move(voxels.xyz, pose)), STEP)
    poses = np.tile(np.eye(4), (12, 1, 1))
    poses[:, 0, 3], poses[:, 2, 3] = np.arange(12), 1.7
    poses = pose @ poses
    poses[:, :3, 3] += ORIGIN
    (out / "tiles").mkdir(parents=True)
    np.savetxt(out / "poses.txt", poses[:, :3].reshape(12, 12), "%.9f")
    {"laz": to_laz, "ply": to_ply}[form](voxels, np.zeros(3), Frame(ORIGIN, 1), out / "tiles" / f"all.{form}")
    summary = {
        "voxels": {}, "tiles": ["all"], "origin": ORIGIN, "intensity_factor": 1, "crs": crs, "config": {"voxel": STEP},
    }  # fmt: skip
    (out / "map.json").write_text(json.dumps(summary))
    return out


BIN = ((3.0, 4.0, 0.2), (3.8, 5.0, 1.3), "other-ground")
PALLET = ((8.0, -5.0, 0.2), (9.0, -4.2, 1.2), "trunk")
FENCE = ((12.0, 4.0, 0.2), (16.0, 4.1, 1.0), "fence")
BEHIND = block((5.0, 11.0, 0.2), (6.0, 12.0, 1.5), "vegetation")  # a wall stands before it


@pytest.fixture(scope="module")
def changed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    folder = tmp_path_factory.mktemp("sessions")
    moved = block((8.0, -1.0, 0.2), (9.0, -0.2, 1.2), "trunk")
    a = session(folder / "a", street(block(*BIN), block(*PALLET)), np.eye(4))
    off = np.eye(4)  # another session's poses are a little elsewhere
    off[:3, :3] = Rotation.from_euler("z", 0.3, degrees=True).as_matrix()
    off[:3, 3] = 0.12, -0.08, 0.03
    b = session(folder / "b", street(moved, block(*FENCE), BEHIND), off, "ply")
    return a, b


def test_what_changed_is_told_by_objects(changed: tuple[Path, Path], tmp_path: Path) -> None:
    summary = diff(*changed, tmp_path)
    assert summary == json.loads((tmp_path / "diff.json").read_text())
    rows = {row["change"]: row for row in summary["changes"]}
    assert summary["objects"] == {"gone": 1, "appeared": 1, "moved": 1}
    assert [rows[kind]["class"] for kind in ("gone", "appeared", "moved")] == [
        "other-ground",
        "fence",
        "trunk",
    ]
    np.testing.assert_allclose(rows["gone"]["box"], np.add([3, 4, 0.2, 3.8, 5, 1.3], ORIGIN * 2), atol=0.25)
    np.testing.assert_allclose(
        rows["appeared"]["box"], np.add([12, 4, 0.2, 16, 4.1, 1], ORIGIN * 2), atol=0.25
    )
    assert abs(rows["moved"]["way_m"] - 4.0) < 0.1
    assert 0.1 < summary["after_moved_m"] < 0.3 and abs(summary["after_turned_deg"] - 0.3) < 0.05
    unseen = summary["voxels"]["after"]["not_seen_by_the_other"]
    assert unseen >= 0.9 * len(fuse(BEHIND, STEP))  # nobody knows whether that is new
    for kind, column in (("gone", "object"), ("appeared", "to")):
        las = laspy.read(tmp_path / f"{kind}.laz")
        elsewhere = np.asarray(las.moved) == 1
        assert set(np.asarray(las.object)[~elsewhere]) == {rows[kind]["object"]}
        assert set(np.asarray(las.object)[elsewhere]) == {rows["moved"][column]}
        assert np.count_nonzero(~elsewhere) == rows[kind]["voxels"]
    picture = np.array(Image.open(io.BytesIO((tmp_path / "diff.png").read_bytes())).convert("RGB"))
    for colour in ((235, 40, 45), (60, 210, 90), (90, 170, 255)):
        assert np.count_nonzero((picture == colour).all(axis=2)) > 150  # more than the legend's square


def test_the_same_street_has_no_changes(changed: tuple[Path, Path], tmp_path: Path) -> None:
    summary = diff(changed[0], changed[0], tmp_path)
    assert summary["changes"] == [] and summary["apart_m"] == 0 == summary["after_moved_m"]
    assert summary["voxels"]["before"]["changed"] == 0 and not list(tmp_path.glob("*.laz"))


def test_the_other_way_round_what_is_gone_appeared(changed: tuple[Path, Path], tmp_path: Path) -> None:
    there, back = (
        {row["change"]: row["class"] for row in diff(*maps, tmp_path / str(k))["changes"]}
        for k, maps in enumerate((changed, changed[::-1]))
    )
    assert back == {"gone": there["appeared"], "appeared": there["gone"], "moved": there["moved"]}


def test_maps_that_cannot_be_compared_are_told(changed: tuple[Path, Path], tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"nowhere: not the folder of a map"):
        diff(changed[0], tmp_path / "nowhere", tmp_path)
    away = np.eye(4)
    away[:3, 3] = 300, 0, 0
    with pytest.raises(SourceError, match=r"does not lie on .*--poses of one frame"):
        diff(changed[0], session(tmp_path / "away", street(), away), tmp_path)
    in_crs = [
        session(tmp_path / crs[-1], block(*BIN), np.eye(4), crs=crs) for crs in ("EPSG:25832", "EPSG:25833")
    ]
    with pytest.raises(UsageError, match="make both in one coordinate system"):
        diff(in_crs[0], in_crs[1], tmp_path)
    (changed[0] / "tiles" / "all.laz").rename(tmp_path / "kept.laz")
    try:
        with pytest.raises(UsageError, match=r"no tile all in LAZ, COPC or PLY.*--formats laz"):
            diff(*changed, tmp_path)
    finally:
        (tmp_path / "kept.laz").rename(changed[0] / "tiles" / "all.laz")


def test_objects_are_what_hangs_together() -> None:
    rng = np.random.default_rng(0)
    cubes = [rng.uniform(0, 1, (n, 3)) + [x, 0, 0] for n, x in ((200, 0), (500, 3), (200, -7))]
    alone = np.array([[50.0, -20.0, -3.0]])
    numbers = objects_of(np.concatenate([alone, *cubes]))
    assert [sorted(set(part)) for part in np.split(numbers, [1, 201, 701])] == [[4], [3], [1], [2]]
    assert len(objects_of(np.empty((0, 3)))) == 0
