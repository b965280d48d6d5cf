"""The stage: one row per scan, measured on what came back."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

from salpcc.schemas.errors import ArchiveError
from salpcc.schemas.scan import Scan
from salpcc.schemas.shards import KEPT
from salpcc.stages.evaluate import stage
from salpcc.stages.evaluate.report.schema import METRICS
from salpcc.stages.ingest.paper_grid import grid_to_scan, row_elevations, scan_to_grid
from salpcc.stages.lattice.lattice import driven
from salpcc.stages.lattice.sensor_model import load_sensor
from salpcc.stages.segment.confusion import group_confusion

Street = Callable[..., Scan]
Rows = Callable[[list[Scan], list[Scan]], pa.Table]


def measure(decoded: Any, sources: list[Any], payloads: pa.Table, **more: Any) -> list[dict[str, Any]]:
    table = stage.run(decoded, sources, payloads, sequence="00", gop=3, **more)
    assert table.schema.equals(METRICS)
    return list(table.to_pylist())


def test_a_bit_exact_scan_has_no_error(street: Street, payload_rows: Rows) -> None:
    scan = street()
    (row,) = measure([scan], [scan], payload_rows([scan], [scan]))
    assert row["bit_exact"] and row["intensity_exact"]
    assert row["max_error_m"] == row["squared_error_m2"] == row["d_d_m2"] == 0.0
    assert (row["sequence"], row["gop"], row["points_compared"]) == ("00", 3, len(scan))
    assert (row["bytes_geometry"], row["bytes_side"], row["points_on_fallback"]) == (1000, 20, 1)


def test_points_that_need_no_correction_are_counted(street: Street, payload_rows: Rows) -> None:
    sensor, n = load_sensor("vlp16"), 5000
    assert sensor.driver is not None
    number = np.random.default_rng(5).integers
    laser, tick = number(0, 16, n).astype(np.uint8), number(0, sensor.ticks_per_turn, n).astype(np.int32)
    points = driven(sensor, laser, tick, number(1000, 20000, n).astype(np.float64)).astype(np.float32)
    points[:9] = np.nextafter(points[:9], np.float32(0))  # another last bit
    points[9] = 0.0  # no return
    scan = Scan("000000", points, np.zeros(n, np.float32))

    def counted(found: Scan, more: dict[str, Any], **asked: Any) -> int | None:
        (row,) = payload_rows([found], [found]).to_pylist()
        (measured,) = measure([found], [found], pa.Table.from_pylist([row | more]), **asked)
        return measured["points_bit_identical"]

    assert counted(scan, {"unmoved": True}, sensor=sensor) == n - 10
    assert counted(scan, {"unmoved": True}, sensor=load_sensor("hdl64e")) == 0
    assert counted(scan, {"unmoved": False}, sensor=sensor) is None
    assert counted(street(), {"bit_identical": 77, "unmoved": False}, sensor=sensor) == 77
    assert counted(scan, {"unmoved": True}, sensor=sensor, max_error=0.01) == 0


def test_one_moved_point_is_found(street: Street, payload_rows: Rows) -> None:
    scan = street()
    points = scan.points.copy()
    points[17, 1] += np.float32(0.5)
    (row,) = measure([replace(scan, points=points)], [scan], payload_rows([scan], [scan]))
    assert row["max_error_m"] == pytest.approx(0.5, abs=1e-6)
    assert not row["bit_exact"] and row["intensity_exact"]


def test_one_changed_intensity_is_found(street: Street, payload_rows: Rows) -> None:
    scan = street()
    intensity = scan.intensity.copy()
    intensity[5] += np.float32(0.01)
    (row,) = measure([replace(scan, intensity=intensity)], [scan], payload_rows([scan], [scan]))
    assert row["max_error_m"] == 0.0
    assert not row["bit_exact"] and not row["intensity_exact"]


@pytest.mark.parametrize("known", [True, False])
def test_dropped_points_are_no_error(
    street: Street, payload_rows: Rows, without_movable: Callable[[Scan], Scan], known: bool
) -> None:
    scan = street()
    task = without_movable(scan)
    assert len(task) < len(scan)
    classes = np.where(np.isin(scan.classes, task.classes), KEPT, scan.classes).astype(np.uint8)
    dropped = {scan.name: classes} if known else None
    (row,) = measure([task], [scan], payload_rows([scan], [task]), dropped=dropped)
    assert row["bit_exact"]
    assert row["points_compared"] == len(task)
    assert row["points_dropped_movable"] == len(scan) - len(task)
    assert np.trace(group_confusion(np.reshape(row["group_counts"], (21, 3)))) == len(scan)
    if known:  # what was dropped counts as the class that it was dropped for
        assert np.trace(np.reshape(row["class_confusion"], (21, 21))) == len(scan)
    else:
        assert row["class_confusion"] is None


def test_the_papers_grid_is_measured_cell_by_cell(street: Street, payload_rows: Rows) -> None:
    scan = street()
    back = grid_to_scan(scan_to_grid(scan, 0.01, row_elevations([scan.points])))
    (row,) = measure(
        [back], [scan], payload_rows([scan], [back]), in_order=False, max_error=0.01, sample=True
    )
    assert row["points_compared"] == len(back) < len(scan)
    assert 0.005 < row["max_error_m"] < 10 and row["d_d_m2"] > 0 and len(row["sample_error_m"]) == len(back)
    assert row["intensity_exact"] and not row["bit_exact"] and not row["in_order"]
    moved = replace(back, points=back.points * np.float32(2))
    (row,) = measure([moved], [scan], payload_rows([scan], [moved]), in_order=False, max_error=0.01)
    assert row["max_error_m"] == np.inf


def test_a_scan_without_source_still_counts_its_bytes(street: Street, payload_rows: Rows) -> None:
    scan = street()
    (row,) = measure([scan], [None], payload_rows([scan], [scan]))
    assert row["bytes_geometry"] == 1000
    assert row["max_error_m"] is None and row["bit_exact"] is None


def test_a_scan_in_another_order_proves_nothing(street: Street, payload_rows: Rows) -> None:
    scan = street()
    turned = Scan(scan.name, scan.points[:0:-1].copy(), scan.intensity[:0:-1].copy())
    far = replace(turned, points=turned.points + np.float32(5000))
    (row,) = measure([far], [scan], payload_rows([scan], [far]))
    assert row["max_error_m"] == np.inf
    assert row["points_compared"] == 0 and not row["bit_exact"]


def test_an_archive_that_ends_early_or_skips_is_refused(street: Street, payload_rows: Rows) -> None:
    first, second = street("000000"), street("000001")
    payloads = payload_rows([first, second], [first, second])
    with pytest.raises(ArchiveError, match="expected scan 000001, decoded no more scans"):
        measure([first], [first, second], payloads)
    with pytest.raises(ArchiveError, match="expected scan 000000, decoded scan 000001"):
        measure([second, first], [first, second], payloads)


def test_decode_time_is_the_time_of_the_pull(street: Street, payload_rows: Rows) -> None:
    scans = [street("000000"), street("000001")]

    def decoder() -> Iterator[Scan]:
        yield scans[0]
        end = time.process_time() + 0.05
        while time.process_time() < end:
            pass
        yield scans[1]

    rows = measure(decoder(), scans, payload_rows(scans, scans))
    assert rows[0]["decode_ms"] < 45 < rows[1]["decode_ms"]


def test_classes_are_measured_where_the_segmenter_has_them(street: Street, payload_rows: Rows) -> None:
    scan = street()
    assert scan.classes is not None
    guess = scan.classes.copy()
    guess[:10] = 15  # vegetation
    coded = replace(scan, classes=guess)
    (row,) = measure([coded], [scan], payload_rows([scan], [scan]), sample=True)
    assert sum(row["class_confusion"]) == len(scan)
    assert np.trace(np.reshape(row["class_confusion"], (21, 21))) < len(scan)
    assert row["sample_predicted"] == guess.tolist() and row["sample_truth"] == scan.classes.tolist()


def test_only_the_first_scan_is_sampled_and_only_when_asked(street: Street, payload_rows: Rows) -> None:
    scans = [street("000000"), street("000001")]
    payloads = payload_rows(scans, scans)
    first, second = measure(scans, scans, payloads, sample=True)
    assert np.array_equal(np.reshape(first["sample_points"], (-1, 3)), scans[0].points)
    assert second["sample_points"] is None
    assert measure(scans, scans, payloads)[0]["sample_points"] is None


@pytest.mark.parametrize("points", [np.empty((0, 3)), [[np.nan, 0, np.inf]], [[1, 2, 3], [1, 2, 3]]])
def test_odd_scans_are_measured_too(points: Any, payload_rows: Rows) -> None:
    places = np.array(points, np.float32)
    scan = Scan("000000", places, np.zeros(len(places), np.float32))
    copy = Scan("000000", places.copy(), scan.intensity.copy())
    (row,) = measure([copy], [scan], payload_rows([scan], [copy]), sample=True)
    assert row["bit_exact"] and row["max_error_m"] == row["d_d_m2"] == 0.0
    assert row["points_decoded"] == len(places)
    assert row["group_counts"] is None
