"""The study of what follows the network: its last variant is what a run does, and the report shows it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from salpcc.schemas.config import RunConfig
from salpcc.schemas.labels import CLASSES
from salpcc.stages.evaluate.report import write as report
from salpcc.stages.evaluate.studies import segment_ablation as ablation
from salpcc.stages.evaluate.studies import segment_sensors as sensors
from salpcc.stages.evaluate.studies.grid_frames import read_gops
from salpcc.stages.ingest.simulator import SimulationConfig, simulate_sequence
from salpcc.stages.ingest.stage import Projector
from salpcc.stages.lattice.sweep import sweep_to_scan
from salpcc.stages.segment.confusion import confusion
from salpcc.stages.segment.labelling import label_gop
from salpcc.stages.segment.training.score import scores


def test_the_last_variant_is_what_a_run_does(tmp_path: Path, sensor) -> None:
    simulate_sequence(SimulationConfig("00", scans=2, seed=3, scene="city"), tmp_path, sensor)
    ablation.run_study(
        ablation.STUDY, ablation.study, ["--root", str(tmp_path), "--out", str(tmp_path / "out"), "00=small"]
    )
    report.build(tmp_path / "out")
    rows = pq.read_table(tmp_path / "out" / "report" / "tables" / "ablation1.parquet").to_pylist()
    assert len(rows) == 5 and {row["sequence"] for row in rows} == {"00"}
    assert (
        rows[0]["movable"] != rows[1]["movable"] or rows[0]["movable, recall"] != rows[1]["movable, recall"]
    )

    said = pq.read_table(tmp_path / "out" / "report" / "tables" / "ablation2.parquet").to_pylist()
    assert len(said) == 5
    for row in said:
        assert 0 <= row["calibration error"] < 0.2 and row["of 0.9 to 1.0"] > row["of 0.0 to 0.1"]

    (gop,) = read_gops(tmp_path, "00")
    project = Projector(sensor)
    unlabelled = [project(number, replace(scan, classes=None)) for number, scan in gop]
    counts = np.zeros((len(CLASSES), len(CLASSES)), np.int64)
    for sweep, (_, scan) in zip(label_gop(unlabelled, sensor, RunConfig()), gop, strict=True):
        known = scan.classes > 0
        counts += confusion(scan.classes[known], sweep_to_scan(sweep, sensor).classes[known], len(CLASSES))
    expected = scores(counts)
    assert rows[-1]["movable"] == pytest.approx(expected["movable"])
    assert rows[-1]["cars found"] == pytest.approx(counts[1, 1:9].sum() / counts[1].sum())
    assert rows[-1]["ground"] == pytest.approx(expected["ground"])


def test_other_sensors_see_fewer_points_of_the_same_scans(tmp_path: Path, sensor) -> None:
    simulate_sequence(SimulationConfig("00", scans=1, seed=3, scene="city"), tmp_path, sensor)
    rows = sensors.study(tmp_path, ablation.folds_of(["00=small"]))
    movable = {row["variant"]: row["value"] for row in rows if row["measure"] == "movable"}
    assert list(movable) == list(sensors.SENSORS)
    recorded = movable["as recorded, 64 rings"]
    assert recorded > 0.5
    assert movable["intensities as counts"] == pytest.approx(recorded, abs=0.1)
    assert movable["ground 0.8 m lower"] == pytest.approx(recorded, abs=0.1)
    assert movable["32 rings"] > recorded - 0.3


def test_weights_are_named_for_every_fold(tmp_path: Path, capsys) -> None:
    for word, hint in (("00", "SEQUENCES=WEIGHTS"), ("00=nowhere.safetensors", "train segment")):
        with pytest.raises(SystemExit):
            ablation.run_study(
                ablation.STUDY,
                ablation.study,
                ["--root", str(tmp_path), "--out", str(tmp_path / "out"), word],
            )
        assert hint in capsys.readouterr().err
