"""Clouds of a known sensor that were moved by their points' times: found, undone to the bit, and told to the fields."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from salpcc.stages.ingest.calibrate.fit_sensor import fit_sensor
from salpcc.stages.lattice import timed_motion
from salpcc.stages.lattice.find_lasers import Listed
from salpcc.stages.lattice.lattice import driven
from salpcc.stages.lattice.list_motion import redo
from salpcc.stages.lattice.sensor_model import SensorModel, load_sensor
from salpcc.stages.lattice.timed_motion import find_timed_motion, timed_places
from salpcc.stages.lists.aimed.aimed_points import OFF_LASER
from salpcc.stages.lists.list_coder import AIMED, MOVED, decode_list, encode_list, off_lattice
from salpcc.stages.lists.list_plan import plan
from salpcc.stages.residual_code.message.field_coder import decode_field, encode_field
from salpcc.stages.residual_code.message.points import Points
from salpcc.stages.residual_code.message.records import BY_LASER, TIMELINE

FIRINGS = 600
DRIVE = np.array([1.1, -0.05, 0.02, 0.001, -0.002, 0.015])  # metres and radians a turn
Cloud = tuple[np.ndarray, np.ndarray, np.ndarray]


@pytest.fixture(scope="module")
def sensor() -> SensorModel:
    return load_sensor("pandar64")


def drive(sensor: SensorModel, reference: float, motion: np.ndarray) -> Cloud:
    """Points of a turn in a street, moved to one moment; their rings, and times of packets of six firings, in ns. A third is missing."""
    rng = np.random.default_rng(0)
    laser, firing = (
        np.tile(np.arange(sensor.n_lasers), FIRINGS),
        np.repeat(np.arange(FIRINGS), sensor.n_lasers),
    )
    tick = firing * 60
    wall = 9.0 + 4.0 * np.sin(firing / FIRINGS * 6 * np.pi) + 3.0 * (firing // 90 % 2)
    far = np.minimum(wall, 1.7 / np.maximum(-np.sin(sensor.theta[laser]), 0.01)) + rng.normal(
        0, 0.01, len(laser)
    )
    time = firing // 6 * 999_900
    still = driven(sensor, laser.astype(np.uint8), tick.astype(np.int32), np.rint(far / sensor.count))
    points = redo(still, timed_places(time, reference), motion).astype(np.float32)
    seen = rng.random(len(laser)) < 0.66
    return points[seen], laser[seen].astype(np.uint8), time[seen]


@pytest.mark.parametrize("reference", [1.0, 0.5, 0.0])
@pytest.mark.parametrize("scale", [1.0, 1e-4])
def test_found_and_undone_to_the_bit(sensor: SensorModel, reference: float, scale: float) -> None:
    points, ring, time = drive(sensor, reference, scale * DRIVE)
    places = np.arange(len(points))
    found = plan(points, 0.0, sensor, lanes=ring, times=time)
    data = encode_list(places, found)
    assert data[4] == MOVED
    _, back, told, sound = decode_list(len(points), 0.0, np.frombuffer(bytearray(data), np.uint8), sensor)
    assert sound
    assert back.tobytes() == points.tobytes()
    assert told is not None
    assert (told.time == time).all()
    assert off_lattice(len(points), data) == (told.laser == OFF_LASER).sum() == 0
    assert len(data) < 0.6 * len(encode_list(places, plan(points, 0.0, sensor)))
    for values, kind in ((time.astype(np.uint32), TIMELINE), (ring.astype(np.uint16), BY_LASER)):
        known = Points.of(points, 0, sensor, told)
        coded = encode_field(values, known)
        assert coded[0] == kind
        assert len(coded) < 400
        assert decode_field(coded, 0, values.dtype, known)[0].tobytes() == values.tobytes()


def test_the_scan_before_leads_to_the_motion(sensor: SensorModel, monkeypatch: pytest.MonkeyPatch) -> None:
    points, ring, time = drive(sensor, 0.5, DRIVE)
    changed = np.array([0.04, 0.01, -0.005, 2e-4, 1e-4, -8e-4])
    far, _ = find_timed_motion(points, sensor, time, ring, (3.0 * DRIVE, 0.5)) or (None, None)
    monkeypatch.setattr(timed_motion, "put_on_cones", None)  # the search of a first scan
    near, reference = find_timed_motion(points, sensor, time, ring, (DRIVE + changed, 0.5)) or (None, None)
    assert reference == 0.5
    for motion in (near, far):
        assert np.abs(motion - DRIVE).max() < 1e-6


def test_clouds_that_stand_still_are_left_alone(sensor: SensorModel) -> None:
    points, ring, time = drive(sensor, 1.0, 0.0 * DRIVE)
    assert find_timed_motion(points, sensor, time, ring) is None
    assert encode_list(np.arange(len(points)), plan(points, 0.0, sensor, lanes=ring, times=time))[4] == AIMED


def test_what_times_do_not_explain_comes_back(sensor: SensorModel) -> None:
    points, ring, time = drive(sensor, 1.0, DRIVE)
    rng = np.random.default_rng(1)
    odd = points.copy()
    odd[::50] += rng.normal(0, 0.3, odd[::50].shape).astype(np.float32)
    odd[5:900:50] = np.nan
    odd[7:900:50] = 0.0
    for cloud, clock in ((odd, time), (points, rng.permutation(time)), (points, time * 0)):
        data = encode_list(np.arange(len(cloud)), plan(cloud, 0.0, sensor, lanes=ring, times=clock))
        _, back, _, sound = decode_list(len(cloud), 0.0, np.frombuffer(bytearray(data), np.uint8), sensor)
        assert sound
        assert back.tobytes() == cloud.tobytes()
        assert 0 < off_lattice(len(cloud), data) <= len(cloud)


def test_calibration_undoes_it(sensor: SensorModel) -> None:
    """A shipped model is recognised; a sensor that nobody knows is fitted."""
    points, ring, time = drive(sensor, 0.5, DRIVE)
    listed = Listed(points.astype(np.float64), ring.astype(np.int64), 0, time)
    known = fit_sensor([listed], "x", rounded=False)
    assert known.moved == 1
    assert known.model.driver is not None
    assert known.model.bit_identical_share > 0.9
    theta = sensor.theta + np.radians(0.3) * np.sin(np.arange(sensor.n_lasers))
    other = replace(sensor, driver=None, theta=theta)
    points, ring, time = drive(other, 1.0, DRIVE)
    fitted = fit_sensor(
        [Listed(points.astype(np.float64), ring.astype(np.int64), 0, time)], "x", rounded=False
    )
    assert fitted.moved == 1
    assert np.median(fitted.off) < 2e-5
    assert np.median(np.abs(fitted.model.theta - theta)) < 1e-5


@settings(max_examples=40, deadline=None)
@given(st.binary(max_size=200), st.integers(1, 300))
def test_any_bytes_end(data: bytes, n: int) -> None:
    """Damage is for the checksum to find; it must neither crash nor hang the decoder."""
    none = np.zeros(2)
    pair = SensorModel(
        "pair", 360, 0.01, np.array([0.1, -0.1]), none, none, none, none, np.zeros(2, np.int64)
    )
    head = b"\x00\x00\x00\x00\x06\x00\x00\x01\x00\x01\x00\x00\x00"
    column = bytes(8) + data[:60]
    motion = np.resize(np.frombuffer(data + b"\x00", np.uint8), 7 * 8).tobytes()
    body = b"\x02\x01\x00\x00\x00\x00\x00\x00\x00" + len(data).to_bytes(4, "little") + data
    for stream in (
        data,
        len(column).to_bytes(4, "little") + column + motion + body,
        bytes(4) + bytes(56) + body,
    ):
        decode_list(n, 0.0, np.frombuffer(bytearray(head + stream), np.uint8), pair)


def test_steps_are_not_sought_where_cones_are_of_another_sensor(
    sensor: SensorModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    locked: list[int] = []

    def lock(found, ticks, count):  # type: ignore[no-untyped-def]
        locked.append(ticks)
        return real(found, ticks, count)

    real = timed_motion.lock
    monkeypatch.setattr(timed_motion, "lock", lock)
    points, laser, time = drive(sensor, 1.0, DRIVE)
    assert find_timed_motion(points, load_sensor("hdl64e"), time, laser) is None
    assert locked == []
    assert find_timed_motion(points, sensor, time, laser) is not None
    assert set(locked) == {sensor.ticks_per_turn}
