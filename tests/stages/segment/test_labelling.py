"""Every scan gets labels: on the lattice, raw, foreign, broken, empty; given labels stay, and nothing is asked in vain."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from salpcc.schemas.config import RunConfig
from salpcc.schemas.labels import GROUP_OF_CLASS, MOVABLE
from salpcc.schemas.scan import Scan
from salpcc.schemas.shards import KEPT, list_array, sweeps_to_table, table_to_sweeps
from salpcc.stages.lattice.sweep import scan_to_sweep, sweep_to_scan
from salpcc.stages.segment import stage
from salpcc.stages.segment.labelling import joined, label_gop


def _odd_scans() -> list[Scan]:
    rng = np.random.default_rng(0)
    foreign = rng.normal(0, 15, (3000, 3)).astype(np.float32)
    broken = foreign.copy()
    broken[::7] = np.nan
    clouds = [foreign, broken, foreign[:1], foreign[:0], np.zeros((50, 3), np.float32)]
    return [
        Scan(f"{i:06d}", cloud, rng.random(len(cloud)).astype(np.float32)) for i, cloud in enumerate(clouds)
    ]


def test_any_scan_is_labelled(make_scan, sensor) -> None:
    scans = [*_odd_scans(), replace(make_scan(), classes=None), replace(make_scan(motion=None), classes=None)]
    sweeps = [scan_to_sweep(scan, sensor) for scan in scans]
    for sweep, scan in zip(label_gop(sweeps, sensor, RunConfig()), scans, strict=True):
        back = sweep_to_scan(sweep, sensor)
        assert (
            back.classes is not None and len(back.classes) == len(scan) and back.classes.max(initial=0) < 20
        )
        assert not back.classes[np.isnan(scan.points).any(axis=1)].any()


def test_what_is_dropped_is_what_the_network_calls_movable(make_scan, sensor) -> None:
    scan = replace(make_scan(), classes=None)
    sweeps = [scan_to_sweep(scan, sensor)]
    classes = sweep_to_scan(label_gop(sweeps, sensor, RunConfig())[0], sensor).classes
    task = stage.run(sweeps_to_table(sweeps), RunConfig())
    movable = GROUP_OF_CLASS[classes] == MOVABLE
    dropped = list_array(task, "dropped_classes", 0)
    assert ((dropped != KEPT) == movable).all() and (dropped[movable] == classes[movable]).all()
    assert (sweep_to_scan(table_to_sweeps(task)[0], sensor).points == scan.points[~movable]).all()


def test_given_labels_stay(make_scan, sensor) -> None:
    sweep = scan_to_sweep(make_scan(), sensor)
    assert label_gop([sweep], sensor, RunConfig())[0] is sweep


def test_a_scan_is_labelled_alike_in_any_company(make_scan, sensor) -> None:
    scans = [replace(make_scan(seed=seed, motion=None), classes=None, time=seed) for seed in (0, 1)]
    sweeps = [scan_to_sweep(scan, sensor) for scan in scans]
    both = label_gop(sweeps, sensor, RunConfig())
    alone = [label_gop([sweep], sensor, RunConfig())[0] for sweep in sweeps]
    for one, other in zip(both, alone, strict=True):
        assert (one.classes == other.classes).all()


def test_keeping_everything_needs_no_network() -> None:
    code = (
        "import sys, numpy as np\n"
        "from salpcc.pipeline import Scan\n"
        "from salpcc.schemas.config import RunConfig\n"
        "from salpcc.stages.lattice.sensor_model import load_sensor\n"
        "from salpcc.stages.lattice.sweep import scan_to_sweep\n"
        "from salpcc.stages.segment.labelling import label_gop\n"
        "sensor = load_sensor('hdl64e')\n"
        "sweep = scan_to_sweep(Scan('0', np.ones((9, 3), np.float32), np.ones(9, np.float32)), sensor)\n"
        "label_gop([sweep], sensor, RunConfig(keep_movable=True, weights='nowhere.safetensors'))\n"
        "assert 'torch' not in sys.modules\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.parametrize(("seconds", "known"), [(0.1, True), (0.0, False), (0.9, False), (-0.1, False)])
def test_scans_follow_across_one_turn_only(make_scan, sensor, seconds: float, known: bool) -> None:
    first = scan_to_sweep(make_scan(), sensor)
    second = replace(first, time=first.time + round(seconds * 1e9))
    assert joined([first, second]) == [False, known]
