"""Every baseline keeps its own promise; one suite for all."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import pytest

from salpcc.schemas.scan import Scan
from salpcc.stages.evaluate.baselines import BASELINES
from salpcc.stages.evaluate.baselines.baseline import FLOAT32_SLACK, Baseline, NotPossible
from salpcc.stages.evaluate.baselines.measure_baseline import measure

LOSSY_ERRORS = (0.001, 0.01, 0.05)


def cases() -> Iterator[object]:
    for name, baseline in BASELINES.items():
        errors = {"exact": (0.0,), "distance": (0.0, *LOSSY_ERRORS)}.get(baseline.promise.bound, LOSSY_ERRORS)
        for error in errors:
            yield pytest.param(name, error, id=f"{name}-{error:g}")


def available(name: str) -> Baseline:
    if missing := BASELINES[name].missing():
        pytest.skip(missing)
    return BASELINES[name]


@pytest.mark.parametrize(("name", "error"), list(cases()))
def test_what_comes_back_is_what_was_promised(name: str, error: float, street: Callable[..., Scan]) -> None:
    baseline, scan = available(name), street(points=4000)
    promise = baseline.promise
    (row,) = measure(name, baseline, [scan], "00", error)
    assert row["status"] == "ok"
    assert row["in_order"] == promise.order
    assert row["bit_exact"] == (error == 0)
    assert ("bytes_total" in row) == promise.intensity
    if promise.count:
        assert row["points_decoded"] == len(scan)
    if promise.bound == "axis":
        assert row["max_axis_error_m"] <= error + FLOAT32_SLACK
        assert row["max_axis_error_m"] > 0.7 * error or error <= 0.001, "the step is not twice the error"
    if promise.bound in ("exact", "distance"):
        assert row["max_error_m"] <= error


@pytest.mark.parametrize("name", [n for n, b in BASELINES.items() if b.promise.intensity])
@pytest.mark.parametrize("hundredths", [True, False])
def test_intensity_comes_back_exactly(name: str, hundredths: bool, street: Callable[..., Scan]) -> None:
    baseline, scan = available(name), street(points=500)
    intensity = scan.intensity if hundredths else np.sqrt(scan.intensity)
    whole = np.column_stack([scan.points, intensity]).astype(np.float32)
    error = 0.0 if baseline.promise.bound == "exact" else 0.005
    decoded = baseline.decode(baseline.encode(whole, error))
    assert decoded.dtype == np.float32 and decoded.shape == whole.shape
    if baseline.promise.order:
        assert np.array_equal(decoded[:, 3], whole[:, 3])
        return
    # Without order: each value belongs to the point that is nearest.
    distance = np.abs(whole[:, None, :3] - decoded[None, :, :3]).max(axis=2)
    mine = (distance <= error + FLOAT32_SLACK) & (whole[:, None, 3] == decoded[None, :, 3])
    assert mine.any(axis=1).all() and mine.any(axis=0).all()


@pytest.mark.parametrize("name", [n for n, b in BASELINES.items() if b.promise.bound != "distance"])
def test_what_a_codec_cannot_do_it_refuses(name: str) -> None:
    baseline = available(name)
    points = np.array([[1, 2, 3], [4, 5, 6]], np.float32)
    with pytest.raises(NotPossible):
        baseline.encode(points, 0.01 if baseline.promise.bound == "exact" else 0.0)


@pytest.mark.parametrize("name", [n for n, b in BASELINES.items() if b.promise.bound in ("axis", "none")])
def test_points_that_are_not_finite_are_refused(name: str) -> None:
    baseline = available(name)
    with pytest.raises(NotPossible):
        baseline.encode(np.array([[1, 2, 3], [np.nan, 5, 6]], np.float32), 0.01)


@pytest.mark.parametrize("name", BASELINES)
def test_encoding_is_deterministic_and_leaves_its_input_alone(name: str, street: Callable[..., Scan]) -> None:
    baseline, points = available(name), street(points=300).points
    before = points.copy()
    error = 0.0 if baseline.promise.bound == "exact" else 0.01
    assert baseline.encode(points, error) == baseline.encode(points, error)
    assert np.array_equal(points, before)


GROUPS = [name for name, baseline in BASELINES.items() if baseline.group is not None]


@pytest.mark.parametrize("name", GROUPS)
def test_a_group_gives_every_scan_back(name: str, street: Callable[..., Scan]) -> None:
    baseline = available(name)
    scans = [street(points=20_000, seed=seed) for seed in range(3)]
    scans = [Scan(str(i), s.points + np.float32([0.8 * i, 0, 0]), s.intensity) for i, s in enumerate(scans)]
    rows = measure(name, baseline, scans, "00", 0.01)
    assert [row["name"] for row in rows] == ["0", "1", "2"]
    assert all(row["status"] == "ok" and row["bytes_geometry"] > 500 for row in rows)
    alone = [row for scan in scans for row in measure(name, baseline, [scan], "00", 0.01)]
    for row, single in zip(rows, alone, strict=True):  # a wrong motion would put points elsewhere
        assert row["d_d_m2"] < 2 * single["d_d_m2"]
        assert row["points_decoded"] > 0.8 * single["points_decoded"]


@pytest.mark.parametrize("name", GROUPS)
def test_the_same_scan_again_is_cheap(name: str, street: Callable[..., Scan]) -> None:
    group = available(name).together()
    points = street(points=20_000).points
    parts = group.encode([points, points], 0.005)
    other = 0 if name == "feng" else 1  # the one that is predicted
    assert len(parts[other]) < 0.8 * len(parts[1 - other])
