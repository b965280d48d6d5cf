"""What the task keeps: dropped classes leave no trace, quantised points stay within the bound."""

import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore

from salpcc.schemas.labels import GROUP_OF_CLASS, MOVABLE
from salpcc.schemas.log import LogMessage
from salpcc.schemas.scan import Scan
from salpcc.stages.ingest.point_cloud import message_to_scan
from salpcc.stages.lattice.lattice import driven
from salpcc.stages.lattice.sensor_model import load_sensor
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


def with_fields(points: np.ndarray, told: dict[str, np.ndarray]) -> Scan:
    """A recorded cloud of points ``(N, 3)`` whose message tells more of them, in whole numbers."""
    rows = np.zeros(len(points), [*((axis, "<f4") for axis in "xyz"), *((name, "<u4") for name in told)])
    rows["x"], rows["y"], rows["z"] = points.T
    for name, values in told.items():
        rows[name] = values
    types = get_typestore(Stores.ROS2_HUMBLE).types
    field = types["sensor_msgs/msg/PointField"]
    cloud = types["sensor_msgs/msg/PointCloud2"](
        header=types["std_msgs/msg/Header"](
            stamp=types["builtin_interfaces/msg/Time"](sec=1, nanosec=0), frame_id="lidar"
        ),
        height=1,
        width=len(rows),
        fields=[
            field(name=n, offset=4 * i, datatype=7 if i < 3 else 6, count=1)
            for i, n in enumerate(rows.dtype.names)
        ],
        is_bigendian=False,
        point_step=rows.dtype.itemsize,
        row_step=rows.nbytes,
        data=rows.view(np.uint8).ravel(),
        is_dense=True,
    )
    raw = bytes(get_typestore(Stores.ROS2_HUMBLE).serialize_cdr(cloud, "sensor_msgs/msg/PointCloud2"))
    return message_to_scan(LogMessage(1, 100, 100, 0, raw), "cdr", "/points", "0")


@pytest.mark.parametrize("told", ["distances", "something else", "distances of other points"])
def test_points_whose_distances_are_told_stay_exact(told: str) -> None:
    """Their bound would be spent on what the field tells to the millimetre anyway."""
    pandar = load_sensor("pandar64")
    rng = np.random.default_rng(0)
    laser, firing = np.tile(np.arange(64), 60), np.repeat(np.arange(60), 64)
    count = np.rint((8.0 + rng.normal(0, 0.5, len(laser))) / pandar.count)
    points = driven(pandar, laser.astype(np.uint8), (firing * 600).astype(np.int32), count).astype(np.float32)
    millimetres = np.rint(1000.0 * count * pandar.count)
    ranges = {
        "distances": millimetres,
        "something else": firing,
        "distances of other points": millimetres[::-1],
    }
    scan = with_fields(points, {"range": ranges[told]})
    task = quantise(scan_to_sweep(scan, pandar), pandar, 0.02)
    error = np.linalg.norm(sweep_to_scan(task, pandar).points.astype(np.float64) - points, axis=1)
    assert (error.max() == 0.0) == (told == "distances")
    assert error.max() <= 0.02


def test_float16_points_of_told_lasers_stay_exact() -> None:
    """As coarse as the bound, they cost more when they are moved to other places."""
    rng = np.random.default_rng(0)
    points = rng.uniform(-20, 20, (3000, 3)).astype(np.float16).astype(np.float32)
    for names, exact in ((("ring", "time"), True), (("ring", "other"), False), (("other", "time"), False)):
        scan = with_fields(points, dict(zip(names, (np.arange(3000) % 16, np.arange(3000)), strict=True)))
        pandar = load_sensor("pandar64")
        sweep = scan_to_sweep(scan, pandar)
        assert (quantise(sweep, pandar, 0.02).max_error == 0.0) == exact
        assert quantise(sweep, pandar, 0.2).max_error == 0.2
