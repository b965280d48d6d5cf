"""What the task keeps: dropped classes leave no trace, quantised points stay within the bound."""

import numpy as np
import pytest

from salpcc.schemas.labels import GROUP_OF_CLASS, MOVABLE
from salpcc.schemas.scan import Scan
from salpcc.stages.lattice.sweep import scan_to_sweep, sweep_to_scan
from salpcc.stages.segment.stage import drop_movable
from salpcc.stages.segment.task import counts_per_level, quantise


def test_dropping_keeps_the_others_in_order(make_scan, sensor) -> None:
    scan = make_scan()
    scan.points[[5, 500, 5000]] = np.nan
    kept = GROUP_OF_CLASS[scan.classes] != MOVABLE
    assert 0 < kept.sum() < len(scan)
    back = sweep_to_scan(drop_movable(scan_to_sweep(scan, sensor), sensor), sensor)
    assert back.points.tobytes() == scan.points[kept].tobytes()
    assert back.intensity.tobytes() == scan.intensity[kept].tobytes()
    assert (back.classes == scan.classes[kept]).all()


@pytest.mark.parametrize("max_error", [0.0005, 0.001, 0.002, 0.005, 0.01, 0.02, 0.1, 1.0])
@pytest.mark.parametrize("moving", [True, False])
def test_no_point_is_farther_than_asked(make_scan, sensor, max_error, moving) -> None:
    scan = make_scan() if moving else make_scan(motion=None)
    scan.points[100:110] += 0.3
    task = quantise(scan_to_sweep(scan, sensor), sensor, max_error)
    back = sweep_to_scan(task, sensor)
    error = np.linalg.norm(back.points.astype(np.float64) - scan.points, axis=1)
    assert len(back) == len(scan)
    assert error.max() <= max_error
    assert (back.intensity == scan.intensity).all()
    assert (back.classes == scan.classes).all()


def test_a_foreign_cloud_is_bounded_too(sensor) -> None:
    rng = np.random.default_rng(0)
    points = rng.normal(0, 30, (3000, 3)).astype(np.float32)
    points[7] = np.nan
    points[8] = 1e30
    scan = Scan("x", points, rng.random(3000).astype(np.float32))
    back = sweep_to_scan(quantise(scan_to_sweep(scan, sensor), sensor, 0.02), sensor)
    error = np.linalg.norm(back.points.astype(np.float64) - points, axis=1)
    assert np.nanmax(error) <= 0.02
    assert (np.isnan(back.points) == np.isnan(points)).all()
    assert back.points[8].tobytes() == points[8].tobytes()


def test_levels_use_the_whole_bound() -> None:
    # A level of n counts is at most n - 1 counts of 2 mm / 2 off, and the rounding takes 0.87 mm.
    assert [counts_per_level(e, 0.002) for e in (0.001, 0.005, 0.01, 0.02)] == [1, 5, 10, 20]
