"""Scans are found in a map, those that it was not made of where there are any; the report has it."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from salpcc.pipeline.cli.app import app
from salpcc.pipeline.edit.cut import Selection, cut
from salpcc.pipeline.mapping.localise_in_map import InMapRequest, localise_in_maps
from salpcc.pipeline.mapping.make_map import make_map
from salpcc.pipeline.mapping.map_request import MapRequest
from salpcc.schemas.errors import UsageError
from salpcc.stages.evaluate.report.collect import collect
from salpcc.stages.evaluate.report.downstream import localisation_figures
from salpcc.stages.evaluate.report.layout.downstream_tables import downstream_tables


@pytest.fixture(scope="module")
def half(
    request_: Callable[..., MapRequest], archive: Path, tmp_path_factory: pytest.TempPathFactory
) -> Path:
    """A map of the first half of the drive."""
    folder = tmp_path_factory.mktemp("half")
    cut(archive, folder / "half.mcap", Selection(frames=(0, 5)))
    make_map(request_(folder / "map", archives=[folder / "half.mcap"], keep_shards=False))
    return folder / "map"


def test_scans_are_found_in_a_map_of_others(archive: Path, half: Path, poses: Path, tmp_path: Path) -> None:
    request = InMapRequest([archive], [half], tmp_path, str(poses), every=2, workers=0, quiet=True)
    table = localise_in_maps(request)
    assert set(table.column("scan").to_pylist()) == {"000006", "000008"}  # not those that the map is of
    rows = localisation_figures(table)
    assert {(row["movable"], row["method"]) for row in rows} == {
        (movable, f"point to {what}") for movable in (True, False) for what in ("point", "plane")
    }
    for row in rows:
        assert row["scans"] == 2 and row["lost"] == 0
    fit = next(row for row in rows if not row["movable"] and row["method"] == "point to plane")
    assert fit["translation_m_mean"] < 0.05 and fit["rotation_deg_mean"] < 0.1
    report = collect(tmp_path)
    assert report["localisation"] == rows
    [shown] = downstream_tables(report)
    assert shown.name == "localisation" and len(shown.rows) == 4
    assert localise_in_maps(request).equals(table)  # from its shards


def test_scans_of_the_map_itself_are_taken_with_a_word(archive: Path, made: Path, tmp_path: Path) -> None:
    result = CliRunner().invoke(
        app,
        [
            "localise",
            str(archive),
            "--map",
            str(made),
            "--every",
            "8",
            "--out",
            str(tmp_path),
            "--workers",
            "0",
        ],
    )
    assert result.exit_code == 0, result.output
    assert "fit what is there of themselves" in " ".join(result.output.split())
    assert "point to plane" in result.output


def test_where_a_map_has_nothing_a_scan_is_lost(
    archive: Path, half: Path, poses: Path, tmp_path: Path
) -> None:
    bare = Path(shutil.copytree(half, tmp_path / "bare"))
    summary = json.loads((bare / "map.json").read_text())
    (bare / "map.json").write_text(json.dumps(summary | {"tiles": []}))
    rows = localisation_figures(
        localise_in_maps(
            InMapRequest([archive], [bare], tmp_path / "out", str(poses), every=9, workers=0, quiet=True)
        )
    )
    assert all(row["lost"] == row["scans"] == 1 and row["translation_m_mean"] is None for row in rows)


def test_wrong_use_of_maps_is_told(archive: Path, half: Path, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="not the folder of a map"):
        localise_in_maps(InMapRequest([archive], [tmp_path], tmp_path / "out"))
    other = Path(shutil.copytree(half, tmp_path / "other"))
    summary = json.loads((other / "map.json").read_text())
    (other / "map.json").write_text(json.dumps(summary | {"crs": "EPSG:25832"}))
    with pytest.raises(UsageError, match="not of the coordinate system of"):
        localise_in_maps(InMapRequest([archive], [half, other], tmp_path / "out"))
    for arguments in (["--map", str(half), "--rivals", "draco"], []):
        result = CliRunner().invoke(
            app, ["localise", str(archive), "--out", str(tmp_path / "out"), *arguments]
        )
        assert isinstance(result.exception, UsageError) and "--against" in str(result.exception)


def test_means_leave_out_what_is_lost() -> None:
    import pyarrow as pa

    rows = [
        {"sequence": "a", "scan": f"{k}", "map": "m", "max_error": 0.0, "movable": True, "method": "point to plane",
         "rotation_deg": turn, "translation_m": way}
        for k, (turn, way) in enumerate([(1.0, 0.1), (3.0, 0.3), (90.0, 8.0), (None, None)])
    ]  # fmt: skip
    [found] = localisation_figures(pa.Table.from_pylist(rows))
    assert (found["scans"], found["lost"]) == (4, 2)
    np.testing.assert_allclose([found["rotation_deg_mean"], found["translation_m_median"]], [2.0, 0.2])
