"""Scan to sweep and back, bit for bit, whatever is in the scan; and on every real scan."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from salpcc.schemas.scan import Scan
from salpcc.stages.lattice.lattice import unproject
from salpcc.stages.lattice.order import azimuth_keys
from salpcc.stages.lattice.publish import points_and_keys, published_points, rounded
from salpcc.stages.lattice.sweep import middle_counts, scan_to_sweep, sweep_to_scan
from salpcc.stages.lattice.untwist import twist


def same_bits(a: Scan, b: Scan) -> bool:
    classes = a.classes is b.classes is None or bool((a.classes == b.classes).all())
    return (
        a.points.tobytes() == b.points.tobytes()
        and a.intensity.tobytes() == b.intensity.tobytes()
        and classes
    )


@pytest.mark.parametrize("moving", [True, False])
def test_a_clean_scan_is_all_lattice(make_scan, sensor, moving) -> None:
    scan = make_scan() if moving else make_scan(motion=None)
    sweep = scan_to_sweep(scan, sensor)
    assert len(sweep.stray_index) <= (5 if moving else 0)
    assert (sweep.motion is not None) == moving
    assert same_bits(sweep_to_scan(sweep, sensor), scan)


def _spoil(scan: Scan, kind: str, rng: np.random.Generator) -> Scan:
    points, intensity = scan.points.copy(), scan.intensity.copy()
    n = len(points)
    at = rng.integers(0, n, 20)
    if kind == "nan":
        points[at] = np.nan
    elif kind == "inf":
        points[at, rng.integers(0, 3, 20)] = np.inf
    elif kind == "duplicate":
        points[(at + 1) % n] = points[at]
    elif kind == "negative zero":
        points[at] = -0.0
    elif kind == "noise":
        points[at] += rng.normal(0, 1, (20, 3)).astype(np.float32)
    elif kind == "swapped":
        points[[at[0], at[1]]] = points[[at[1], at[0]]]
    elif kind == "huge":
        points[at] = 3e38
    elif kind == "odd intensity":
        intensity[at] = rng.random(20).astype(np.float32)
    elif kind == "nan intensity":
        intensity[at] = np.nan
    return replace(scan, points=points, intensity=intensity)


SPOILS = (
    "nan", "inf", "duplicate", "negative zero", "noise", "swapped", "huge", "odd intensity", "nan intensity",
)  # fmt: skip


@pytest.mark.parametrize("kind", SPOILS)
def test_spoilt_points_become_strays_and_nothing_else_does(make_scan, sensor, kind) -> None:
    scan = _spoil(make_scan(), kind, np.random.default_rng(3))
    sweep = scan_to_sweep(scan, sensor)
    assert same_bits(sweep_to_scan(sweep, sensor), scan)
    assert len(sweep.stray_index) <= 60


@settings(max_examples=15, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(kinds=st.sets(st.sampled_from(SPOILS)), seed=st.integers(0, 1000))
def test_any_mixture_comes_back(make_scan, sensor, kinds, seed) -> None:
    rng = np.random.default_rng(seed)
    scan = make_scan(stride=16)
    for kind in sorted(kinds):
        scan = _spoil(scan, kind, rng)
    assert same_bits(sweep_to_scan(scan_to_sweep(scan, sensor), sensor), scan)


@pytest.mark.parametrize("moving", [False, True])
def test_points_and_keys_in_one_pass_are_those_of_each_step(make_scan, sensor, moving) -> None:
    sweep = scan_to_sweep(make_scan(stride=16) if moving else make_scan(stride=16, motion=None), sensor)
    plain = replace(sweep, ulp=np.full_like(sweep.ulp, 13))
    coarse = replace(sweep, step=7, max_error=0.01, count=sweep.count // 7)
    for case in (plain, coarse):
        points, keys = points_and_keys(case, sensor)
        model = unproject(sensor, case.laser, case.tick, middle_counts(case))
        np.testing.assert_array_equal(keys, azimuth_keys(model))
        if case is plain:
            expected = published_points(rounded(model, case.millimetre, case.motion))
        else:
            expected = (twist(model, case.motion) if moving else model).astype(np.float32)
        np.testing.assert_array_equal(points, expected)


@pytest.mark.parametrize("n", [0, 1, 2, 10, 300])
def test_small_and_foreign_scans_come_back(sensor, n) -> None:
    rng = np.random.default_rng(n)
    scan = Scan("x", rng.normal(0, 20, (n, 3)).astype(np.float32), rng.random(n).astype(np.float32))
    sweep = scan_to_sweep(scan, sensor)
    assert len(sweep.laser) == 0
    assert same_bits(sweep_to_scan(sweep, sensor), scan)


def test_a_handful_of_lattice_points_comes_back(make_scan, sensor) -> None:
    scan = make_scan(motion=None)
    few = Scan("x", scan.points[::5000], scan.intensity[::5000])
    sweep = scan_to_sweep(few, sensor)
    assert len(sweep.stray_index) == 0
    assert same_bits(sweep_to_scan(sweep, sensor), few)


def test_every_real_scan_comes_back(real_data, sensor) -> None:
    files = sorted(real_data.glob("semantickitti/sequences/*/velodyne/*.bin"))
    files += sorted(real_data.glob("kitti_raw/**/*.bin"))
    motion = None
    corrected, points = 0, 0
    for file in files:
        values = np.fromfile(file, np.float32).reshape(-1, 4)
        scan = Scan(file.stem, values[:, :3].copy(), values[:, 3].copy())
        sweep = scan_to_sweep(scan, sensor, motion)
        motion = sweep.motion
        assert same_bits(sweep_to_scan(sweep, sensor), scan), file
        assert len(sweep.stray_index) < 200, file
        corrected += int((sweep.millimetre != 13).sum())
        points += len(scan)
    assert len(files) == 77
    assert corrected < 0.01 * points
