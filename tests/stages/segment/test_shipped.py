"""The weights that ship: what they must reach on sequence 06, which they never saw."""

import json
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from salpcc.schemas.scan import Scan
from salpcc.stages.evaluate.studies.segment_ablation import groups
from salpcc.stages.evaluate.studies.segment_sensors import count_seen
from salpcc.stages.segment.labelling import network_classes
from salpcc.stages.segment.network import checkpoint
from salpcc.stages.segment.network.checkpoint import load_cached, load_weights
from salpcc.stages.segment.network.projection import project
from salpcc.stages.segment.training.score import scores
from salpcc.stages.segment.weights_file import any_sensor, weights_path


@pytest.mark.parametrize("path", [weights_path("small"), any_sensor(weights_path("small"))])
def test_they_name_what_they_saw(path) -> None:
    network, facts = load_weights(path)
    assert network.config.width == "small" and path.stat().st_size < 10e6
    assert facts["sequences"] and "06" not in facts["sequences"]


def test_a_run_drops_the_movable_points_of_06(real_data, tmp_path) -> None:
    command = [
        sys.executable,
        "-m",
        "salpcc.pipeline.cli",
        "run",
        "sequences",
        "06",
        "--frames",
        "0:3",
        "--json",
    ]
    where = [
        "--root",
        real_data / "semantickitti",
        "--out",
        tmp_path,
        "--workers",
        "0",
        "--effort",
        "fast",
        "--drop-movable",
    ]
    done = subprocess.run([*map(str, [*command, *where])], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    figures = json.loads(done.stdout)["sequences"]["06"]
    iou = figures["iou"]["groups_without_terrain"]
    assert iou["movable"] > 0.85 and iou["ground"] > 0.95 and iou["other"] > 0.92
    assert figures["iou"]["movable_recall"] > 0.89 and figures["iou"]["movable_precision"] > 0.94
    assert figures["points_decoded"] + figures["points_dropped_movable"] == figures["points_in"]
    assert figures["points_dropped_movable"] > 0.02 * figures["points_in"]


@pytest.mark.parametrize(
    ("sensor", "movable", "ground"),
    [("32 rings", 0.75, 0.94), ("no intensities", 0.7, 0.95), ("ground 0.8 m lower", 0.8, 0.94)],
)
def test_they_know_06_as_other_sensors_would_have_seen_it(
    real_data, sensor: str, movable: float, ground: float
) -> None:
    group = next(groups(real_data / "semantickitti", "06"))[:3]
    found = scores(count_seen(sensor, group, weights_path("small")))
    assert found["movable"] > movable and found["ground"] > ground


def test_other_rings_and_no_intensities_are_asked_of_the_weights_for_any_sensor(
    make_scan, monkeypatch
) -> None:
    asked = []
    monkeypatch.setattr(
        checkpoint,
        "load_cached",
        lambda path, device: (asked.append(path.stem), load_cached(path, device))[1],
    )
    whole = make_scan(stride=1, motion=None)
    row = project(whole.points, whole.intensity).row
    few = row % 2 == 0
    unlit = replace(whole, intensity=np.zeros_like(whole.intensity))
    for scan in (whole, unlit, Scan("few", whole.points[few], whole.intensity[few], 0)):
        (classes,) = network_classes([scan], [False], [None], "small")
        assert len(classes) == len(scan)
    assert asked == ["segment_small", "segment_small_any", "segment_small_any"]
