"""An archive beside its source: each point's error, of a layer, too, and what is said where they are not of one another."""

import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from salpcc.pipeline.against import Originals
from salpcc.pipeline.archive import Archive
from salpcc.pipeline.run import RunResult
from salpcc.pipeline.view import view
from salpcc.schemas.errors import ArchiveError, SourceError, UsageError
from salpcc.stages.ingest.sources import SOURCES
from salpcc.stages.residual_code.archive.reader import ArchiveReader


@pytest.fixture(scope="module")
def rough(toy_root: Path, tmp_path_factory: pytest.TempPathFactory, run: Callable[..., RunResult]) -> Path:
    """Two layers of sequence 01, 5 cm of each bounded."""
    out = tmp_path_factory.mktemp("rough")
    options = {"max_error": 0.05, "effort": "fast", "labels": "given", "keep_movable": False}
    assert not run(toy_root, out, "01", **options).failed
    return out / "archives" / "01.mcap"


def test_errors_are_those_of_each_point(rough: Path, toy_root: Path) -> None:
    source = Originals(ArchiveReader(rough), toy_root)
    files = SOURCES["semantickitti"]
    with Archive.open(rough) as both, Archive.open(rough, layers="static") as static:
        for ref, scan, part in zip(files.scans(toy_root, "01"), both, static, strict=True):
            errors = source.errors(scan)
            points = files.read(ref, with_labels=False).points
            assert np.allclose(errors, np.linalg.norm(points.astype(float) - scan.points, axis=1), atol=1e-9)
            assert 0 < errors.max() <= 0.05 and len(source.errors(part)) == len(part) < len(scan)
            assert source.errors(part).max() <= 0.05


def test_what_is_not_of_the_source_is_told(rough: Path, toy_root: Path, tmp_path: Path) -> None:
    reader = ArchiveReader(rough)
    with pytest.raises(UsageError, match="nowhere not found"):
        Originals(reader, tmp_path / "nowhere")
    source = Originals(reader, toy_root)
    with Archive.open(rough) as archive:
        scan = archive[0]
    with pytest.raises(SourceError, match=f"scan 000005: not in {toy_root}"):
        source.errors(replace(scan, name="000005"))
    part = slice(0, len(scan) // 2)
    moved = replace(scan, points=scan.points[part] + np.float32(5000), intensity=scan.intensity[part],
                    classes=None, labels=None, movable=None)  # fmt: skip
    with pytest.raises(ArchiveError, match=r"are not those of .*000000\.bin"):
        source.errors(moved)


def test_the_viewer_shows_errors(rough: Path, toy_root: Path, tmp_path: Path) -> None:
    pytest.importorskip("rerun")
    assert view(rough, against=toy_root, save=tmp_path / "a.rrd") == 3
    command = [sys.executable, "-m", "rerun", "rrd", "print", "-vvv", str(tmp_path / "a.rrd")]
    printed = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert "/sensor/error" in printed and "largest error 4" in printed
