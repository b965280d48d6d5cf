"""The paper profile through the pipeline: run, decode, verify, inspect."""

from pathlib import Path

import numpy as np
import pytest

from salpcc.pipeline.archive import Archive
from salpcc.pipeline.inspect import inspect
from salpcc.pipeline.run import RunRequest, run_sequences
from salpcc.pipeline.verify import verify
from salpcc.schemas.config import RunConfig
from salpcc.stages.ingest.sources import SOURCES
from salpcc.stages.residual_code.archive.reader import ArchiveReader


@pytest.fixture(scope="module")
def archive(toy_root: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, object]]:
    """Sequence 01 of the toy scans (0, 1 and, after a gap, 7) in GOPs of two, movables dropped."""
    out = tmp_path_factory.mktemp("paper")
    config = RunConfig(profile="paper", max_error=0.005, labels="given", gop=2)
    result = run_sequences(RunRequest(config, ["01"], out, toy_root, workers=0, quiet=True))
    assert result.report is not None and not result.failed
    return out / "archives" / "01.mcap", result.report["sequences"]["01"]


def test_what_was_lost_is_counted(archive: tuple[Path, dict[str, object]]) -> None:
    path, total = archive
    rows = inspect(path)["rows"]
    lost = sum(row["n_points"] - row["dropped_movable"] - row["kept"] for row in rows)
    assert total["points_lost"] == lost > 0
    assert total["points_dropped_movable"] > 0
    beside = total["labels"]["bytes"] + total["side_files"]["bytes"]  # type: ignore[index]
    assert total["bytes"]["total"] == path.stat().st_size - beside  # type: ignore[index]
    assert 0.0025 < float(total["max_error_m"]) < 1.0  # type: ignore[arg-type]


def test_points_are_the_source_s_on_the_grid(archive: tuple[Path, dict[str, object]], toy_root: Path) -> None:
    verdict = verify(archive[0], toy_root)
    assert verdict.good, verdict.problems
    assert verdict.scans == 3
    assert verdict.points_dropped > 0


def test_verify_finds_other_sources(
    archive: tuple[Path, dict[str, object]], tmp_path: Path, toy_root: Path
) -> None:
    folder = tmp_path / "sequences" / "01" / "velodyne"
    folder.mkdir(parents=True)
    for ref in SOURCES["semantickitti"].scans(toy_root, "01"):
        rows = np.fromfile(ref.path, "<f4") * np.float32(1.02)
        rows.astype("<f4").tofile(folder / Path(ref.path).name)
        labels = tmp_path / "sequences" / "01" / "labels"
        labels.mkdir(exist_ok=True)
        assert ref.labels is not None
        (labels / Path(ref.labels).name).write_bytes(Path(ref.labels).read_bytes())
    assert not verify(archive[0], tmp_path).good


def test_a_gop_decodes_alone(archive: tuple[Path, dict[str, object]]) -> None:
    with Archive.open(archive[0]) as scans:
        last = scans[2]
        assert [scan.name for scan in scans] == ["000000", "000001", "000007"]
        assert last.points.tobytes() == list(scans)[2].points.tobytes()
        assert last.classes is not None and len(last.classes) == len(last.points)
    assert len(ArchiveReader(archive[0]).gops) == 2


def test_the_configuration_names_what_decided_the_bytes(archive: tuple[Path, dict[str, object]]) -> None:
    config = ArchiveReader(archive[0]).facts.config
    assert config["profile"] == "paper" and config["coder"] == "ppmd" and config["max_error"] == 0.005
    assert "coder" not in RunConfig().coding
