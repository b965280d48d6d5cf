"""The weights that ship: what they must reach on sequence 06, which they never saw."""

import json
import subprocess
import sys

from salpcc.stages.segment.network.checkpoint import load_weights
from salpcc.stages.segment.weights_file import weights_path


def test_they_name_what_they_saw() -> None:
    path = weights_path("small")
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
