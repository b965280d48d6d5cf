"""KITTI-like folders whose scans have five numbers a point: nuScenes, SUSTechPOINTS and others."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import plyfile
import pytest

from salpcc.pipeline import Archive
from salpcc.pipeline.export import EXPORTS
from salpcc.pipeline.run import RunResult
from salpcc.pipeline.verify import verify

Run = Callable[..., RunResult]


@pytest.fixture(scope="module")
def wide_root(tmp_path_factory: pytest.TempPathFactory, toy_root: Path) -> Path:
    """The toy scans with a ring for each point."""
    root = tmp_path_factory.mktemp("wide")
    folder = root / "sequences" / "00" / "velodyne"
    folder.mkdir(parents=True)
    for file in (toy_root / "sequences" / "00" / "velodyne").iterdir():
        rows = np.fromfile(file, "<f4").reshape(-1, 4)
        ring = (np.arange(len(rows)) % 32).astype("<f4")
        np.column_stack([rows, ring]).astype("<f4").tofile(folder / file.name)
    return root


@pytest.mark.parametrize("max_error", [None, 0.01])
def test_five_columns_come_back(wide_root: Path, tmp_path: Path, run: Run, max_error: float | None) -> None:
    assert not run(wide_root, tmp_path / "out", "00", columns=5, effort="fast", max_error=max_error).failed
    path = tmp_path / "out" / "archives" / "00.mcap"
    verdict = verify(path, wide_root)
    assert verdict.good and verdict.scans == 5, verdict.problems
    assert (verdict.bit_exact_scans == 5) == (max_error is None)
    with Archive.open(path) as archive:
        files = list(EXPORTS["kitti"](archive, iter(archive), tmp_path / "back"))
        ply = next(iter(EXPORTS["ply"](archive, iter(archive[:1]), tmp_path / "ply")))
    for file in files:
        here = np.fromfile(file, "<f4").reshape(-1, 5)
        there = np.fromfile(wide_root / file.relative_to(tmp_path / "back"), "<f4").reshape(-1, 5)
        assert here[:, 3:].tobytes() == there[:, 3:].tobytes()
        off = np.linalg.norm(here[:, :3].astype(np.float64) - there[:, :3], axis=1)
        assert off.max() <= (max_error or 0.0)
    vertices = plyfile.PlyData.read(ply)["vertex"]
    assert vertices["ring"][:40].tolist() == [float(i % 32) for i in range(40)]


def test_four_columns_are_told(wide_root: Path, tmp_path: Path, run: Run) -> None:
    result = run(wide_root, tmp_path, "00", effort="fast", max_error=0.01)
    assert result.failed and all("--columns 5" in error.reason for error in result.errors)
