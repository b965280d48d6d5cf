"""One file and one line in one table: a toy source, baseline, export and table run like those that are there.

A toy stage is in ``tests/stages/test_coding.py``.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from salpcc.pipeline.archive import Archive
from salpcc.pipeline.cli.app import app
from salpcc.pipeline.export import EXPORTS
from salpcc.pipeline.run import RunRequest, run_sequences
from salpcc.pipeline.verify import verify
from salpcc.schemas.config import RunConfig
from salpcc.schemas.scan import Scan
from salpcc.schemas.work import ScanRef
from salpcc.stages.evaluate.baselines import BASELINES
from salpcc.stages.evaluate.baselines.baseline import Baseline, Promise
from salpcc.stages.evaluate.report.layout import report_tables
from salpcc.stages.evaluate.report.layout.tables import Column, Table
from salpcc.stages.ingest.sources import SOURCES
from salpcc.stages.ingest.sources.files import Files


class Texts(Files):
    """A source: scans as lines of text."""

    name = "texts"
    hint = "Type some numbers into ROOT/NAME/*.txt"

    def sequences(self, root: Path) -> list[str]:
        return sorted(p.name for p in root.iterdir() if p.is_dir())

    def folder(self, root: Path, sequence: str) -> None:
        return None

    def scans(self, root: Path, sequence: str) -> list[ScanRef]:
        files = sorted((root / sequence).glob("*.txt"))
        return [ScanRef(file.stem, at, str(file), at) for at, file in enumerate(files)]

    def read(self, ref: ScanRef, with_labels: bool) -> Scan:
        rows = np.loadtxt(ref.path, np.float32, ndmin=2)
        return Scan(ref.name, rows[:, :3].copy(), rows[:, 3].copy(), ref.time)


def test_a_source_a_baseline_a_table_and_an_export(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "root" / "a").mkdir(parents=True)
    rng = np.random.default_rng(0)
    for name in ("one", "two"):
        np.savetxt(tmp_path / "root" / "a" / f"{name}.txt", rng.normal(0, 9, (40, 4)), fmt="%.3f")
    monkeypatch.setitem(SOURCES, "texts", Texts())
    copy = Baseline(
        "Copy",
        (),
        Promise("exact", order=True, count=True, intensity=True),
        lambda points, _: bytes([points.shape[1]]) + points.astype("<f4").tobytes(),
        lambda data: np.frombuffer(data[1:], "<f4").reshape(-1, data[0]).copy(),
    )
    monkeypatch.setitem(BASELINES, "copy", copy)  # type: ignore[misc]
    scans = Column("frames", "scans")
    toy = Table("toy", "Toy", (scans,), ({"frames": 2},))
    monkeypatch.setattr(report_tables, "TABLES", (*report_tables.TABLES, lambda report: [toy]))
    config = RunConfig(source="texts", keep_movable=True, effort="fast", baselines=("copy",))
    request = RunRequest(config, ["a"], tmp_path / "out", tmp_path / "root", 0, quiet=True)
    result = run_sequences(request)
    assert not result.failed and result.report is not None
    assert result.report["sequences"]["a"]["bit_exact_scans"] == 2
    assert "## Toy" in (tmp_path / "out" / "report" / "tables.md").read_text()
    archive = tmp_path / "out" / "archives" / "a.mcap"
    assert verify(archive, tmp_path / "root").bit_exact_scans == 2

    def to_texts(archive: Archive, scans: Iterator[Scan], out: Path, *_: object) -> Iterator[Path]:
        for scan in scans:
            out.mkdir(exist_ok=True)
            np.savetxt(out / f"{scan.name}.txt", np.column_stack([scan.points, scan.intensity]), fmt="%.3f")
            yield out / f"{scan.name}.txt"

    monkeypatch.setitem(EXPORTS, "texts", to_texts)
    done = CliRunner().invoke(app, ["decode", str(archive), "--to", "texts", "--out", str(tmp_path / "back")])
    assert done.exit_code == 0, done.output
    for file in (tmp_path / "root" / "a").iterdir():
        assert (tmp_path / "back" / file.name).read_text() == file.read_text()
