"""Points of a calibrated sensor: exact or within the bound in any order, and in far fewer bits than on guessed rays."""

import zlib
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from salpcc.schemas.scan import Scan
from salpcc.stages.ingest.calibrate.fit_sensor import fit_sensor
from salpcc.stages.lattice.aim import Placed, aim
from salpcc.stages.lattice.find_lasers import Listed
from salpcc.stages.lattice.lattice import unproject
from salpcc.stages.lattice.list_motion import places, redo
from salpcc.stages.lattice.sensor_model import SensorModel
from salpcc.stages.lattice.sweep import scan_to_sweep, sweep_to_scan
from salpcc.stages.lists.list_coder import AIMED, decode_list, encode_list
from salpcc.stages.lists.list_plan import plan, snap
from salpcc.stages.residual_code.gop import decode_any, encode_gop
from salpcc.stages.residual_code.sensor.payload import unpack
from salpcc.stages.segment.task import quantise

Points = NDArray[np.float32]
LASERS, COLUMNS = 32, 512
MOTION = np.array([-0.5, 0.01, 0.01, 1e-3, -5e-4, 3e-3])


def in_order(rows: Points, order: str) -> Points:
    points = rows if order.startswith("rows") else rows.transpose(1, 0, 2)
    points = points.reshape(-1, 3).copy()
    return points[(points != 0).any(axis=1)] if order.endswith("returns") else points


@pytest.mark.parametrize("order", ["rows", "rows, returns", "firings", "firings, returns"])
@pytest.mark.parametrize(
    ("max_error", "gain"), [(0.0, 0.5), (0.001, 0.75), (0.005, 0.75), (0.01, 0.8), (0.02, 0.85)]
)
def test_gains_in_any_order(
    fan: SensorModel, rows: Points, order: str, max_error: float, gain: float
) -> None:
    points = in_order(rows, order)
    sizes = {}
    for sensor in (None, fan):
        snapped = snap(points, max_error, sensor)
        data = encode_list(np.arange(len(points)), plan(snapped, max_error, sensor))
        read = np.frombuffer(bytearray(data), np.uint8)
        back, decoded, _, sound = decode_list(len(points), max_error, read, sensor)
        assert sound
        assert decoded.tobytes() == snapped.tobytes()
        assert (back == np.arange(len(points))).all()
        assert np.linalg.norm(decoded.astype(np.float64) - points, axis=1).max() <= max_error
        sizes[sensor] = len(data)
    assert sizes[fan] < gain * sizes[None]


@pytest.mark.parametrize("max_error", [0.0, 0.01])
def test_what_is_off_the_lattice_keeps_its_place(fan: SensorModel, rows: Points, max_error: float) -> None:
    points = in_order(rows, "rows")
    rng = np.random.default_rng(2)
    odd = rng.random(len(points)) < 0.03
    points[odd] += rng.normal(0, 0.3, (int(odd.sum()), 3)).astype(np.float32)
    points[5:9] = [[np.nan] * 3, [np.inf, 0, 1], [0, 0, 3], [-0.0, 0, 0]]
    snapped = snap(points, max_error, fan)
    data = encode_list(np.arange(len(points)), plan(snapped, max_error, fan))
    assert data[4] == AIMED
    _, decoded, _, sound = decode_list(len(points), max_error, np.frombuffer(bytearray(data), np.uint8), fan)
    assert sound
    assert decoded.tobytes() == snapped.tobytes()
    finite = np.isfinite(points).all(axis=1)
    assert np.linalg.norm(decoded[finite].astype(np.float64) - points[finite], axis=1).max() <= max_error
    assert snapped[~finite].tobytes() == points[~finite].tobytes()


@pytest.mark.parametrize("grid", [False, True])
def test_places_that_are_told_are_those_that_are_found(fan: SensorModel, rows: Points, grid: bool) -> None:
    points = in_order(rows, "firings")
    rng = np.random.default_rng(3)
    points[rng.random(len(points)) < 0.03] *= np.float32(1.01)
    points = (np.rint(points * 1000) / 1000).astype(np.float32) if grid else points
    points[5:8] = [[np.nan] * 3, [0, 0, 3], [-0.0, 0, 0]]
    data = encode_list(np.arange(len(points)), plan(points, 0.0, fan))
    _, back, told, sound = decode_list(len(points), 0.0, np.frombuffer(bytearray(data), np.uint8), fan)
    assert sound and isinstance(told, Placed)
    assert 0.5 < told.known.mean() < 1.0
    wide = back.astype(np.float64)
    for known, sought in zip(aim(fan, wide, placed=told), aim(fan, wide), strict=True):
        assert np.array_equal(known, sought)


def test_a_cloud_that_is_nearly_void(fan: SensorModel, rows: Points) -> None:
    """Zeros are whole millimetres, but say nothing of the points that are none."""
    points = in_order(rows, "rows")
    points[np.arange(len(points)) % 20 > 0] = 0
    data = encode_list(np.arange(len(points)), plan(points, 0.0, fan))
    _, decoded, _, sound = decode_list(len(points), 0.0, np.frombuffer(bytearray(data), np.uint8), fan)
    assert sound
    assert decoded.tobytes() == points.tobytes()
    assert data[4] == AIMED


def test_firings_rounded_to_millimetres(fan: SensorModel, rows: Points) -> None:
    """Whole millimetres are corrected as such; a coordinate of -0.0 is no whole number of anything."""
    points = (np.rint(in_order(rows, "firings, returns") * 1000.0) / 1000.0).astype(np.float32)
    points[::100, 1] = -0.0
    data = encode_list(np.arange(len(points)), plan(points, 0.0, fan))
    _, decoded, _, sound = decode_list(len(points), 0.0, np.frombuffer(bytearray(data), np.uint8), fan)
    assert sound
    assert decoded.tobytes() == points.tobytes()
    assert data[4] == AIMED
    assert len(data) < 0.8 * len(encode_list(np.arange(len(points)), plan(points, 0.0)))


@pytest.mark.parametrize("seen", [COLUMNS, COLUMNS // 8])
def test_another_sensor_changes_nothing(
    fan: SensorModel, sensor: SensorModel, rows: Points, seen: int
) -> None:
    """Also where most of the cloud is void, which lies on any lattice."""
    points = in_order(rows * (np.arange(COLUMNS) < seen)[:, None], "firings")
    for max_error in (0.0, 0.005):
        coded = [
            encode_list(np.arange(len(points)), plan(snap(points, max_error, other), max_error, other))
            for other in (None, sensor)
        ]
        assert len(coded[1]) <= len(coded[0])


@pytest.mark.parametrize("max_error", [0.0, 0.005, 0.01])
def test_moved_firings_through_the_whole_codec(fan: SensorModel, rows: Points, max_error: float) -> None:
    """A calibrated sensor whose clouds are moved to one moment: the motion is found, and all comes back."""
    fine = replace(fan, ticks_per_turn=36_000, count=0.002, h=np.zeros(LASERS), phi0=np.zeros(LASERS))
    laser = np.tile(np.arange(LASERS), 1000)
    tick = np.repeat(np.arange(1000) * 36, LASERS)
    far = np.minimum(
        12.0 + 5.0 * np.sin(tick / 36_000 * 6 * np.pi), 1.7 / np.maximum(-np.sin(fan.theta[laser]), 0.02)
    )
    count = np.rint((far + np.random.default_rng(3).normal(0, 0.01, len(tick))) / fine.count)
    still = unproject(fine, laser.astype(np.uint8), tick.astype(np.int32), count)
    points = redo(still, places(len(still), LASERS), MOTION).astype(np.float32)
    scan = Scan("0", points, np.zeros(len(points), np.float32))
    sweep = scan_to_sweep(scan, fine)
    assert sweep.motion is not None
    assert np.abs(sweep.motion - MOTION)[:3].max() < 1e-3
    task = quantise(sweep, fine, max_error) if max_error else sweep
    data = encode_gop([task], fine, "default")[0].data
    (decoded,) = decode_any([data], fine)
    back = sweep_to_scan(decoded, fine).points
    if max_error:
        assert np.linalg.norm(back.astype(np.float64) - points, axis=1).max() <= max_error
    else:
        assert back.tobytes() == points.tobytes()
    assert unpack(data)[1]["stray_points"][4] == AIMED
    plain = plan(snap(points, max_error), max_error)
    assert len(data) < 0.75 * len(encode_list(np.arange(len(points)), plain))


def test_real_sweep_gains(real_data) -> None:
    file = real_data / "other_sensors" / "nuscenes_lidar_top.pcd.bin"
    if not file.is_file():
        pytest.skip(f"{file} is absent")
    points = np.ascontiguousarray(np.fromfile(file, "<f4").reshape(-1, 5)[:, :3])
    model = fit_sensor([Listed(points.astype(np.float64))], "hdl32e", rounded=False).model
    sweep = quantise(scan_to_sweep(Scan("0", points, np.zeros(len(points), np.float32)), model), model, 0.01)
    snapped = sweep.stray_points[:, :3]
    data = encode_list(sweep.stray_index, plan(snapped, 0.01, model, sweep.motion))
    assert 8 * len(data) / len(points) < 4.6  # on guessed rays: 8.6
    assert np.linalg.norm(snapped.astype(np.float64) - points, axis=1).max() <= 0.01


@pytest.mark.parametrize(("max_error", "digest"), [(0.0, 3236820773), (0.01, 147632184)])
def test_bytes_stay_what_they_are(max_error: float, digest: int) -> None:
    """Golden bytes, of numbers that every machine makes alike: a change here is a change of the format."""
    none = np.zeros(8)
    theta = np.array([0.2, 0.15, 0.1, 0.05, 0.0, -0.05, -0.1, -0.15])
    fixed = SensorModel("fixed", 720, 0.004, theta, none, none + 0.001, none, none, np.zeros(8, np.int64))
    laser, tick = np.tile(np.arange(8), 120), np.repeat(np.arange(120) * 6, 8)
    count = 2000 + 7 * laser + np.abs(tick - 300) + (tick * 37 + laser * 11) % 13
    still = unproject(fixed, laser.astype(np.uint8), tick.astype(np.int32), count.astype(np.int32))
    points = redo(still, places(960, 8), MOTION).astype(np.float32)
    points[::31] += np.float32(0.25)
    points = snap(points, max_error, fixed, MOTION)
    data = encode_list(np.arange(960), plan(points, max_error, fixed, MOTION))
    assert data[4] == AIMED
    assert zlib.crc32(data) == digest


@settings(max_examples=40, deadline=None)
@given(st.binary(max_size=200), st.integers(1, 300), st.booleans())
def test_any_bytes_end(data: bytes, n: int, moved: bool) -> None:
    """Damage is for the checksum to find; it must neither crash nor hang the decoder."""
    none = np.zeros(2)
    pair = SensorModel(
        "pair", 360, 0.01, np.array([0.1, -0.1]), none, none, none, none, np.zeros(2, np.int64)
    )
    for max_error in (0.0, 0.01):
        form = b"\x02" if max_error == 0.0 else b"\x00"
        head = b"\x00\x00\x00\x00\x03\x02\x00\x01\x00\x01\x00\x00\x00" + form + b"\x01\x00\x00\x00"
        body = np.frombuffer(
            bytearray(head + b"\x00\x00\x00\x00" + len(data).to_bytes(4, "little") + data), np.uint8
        )
        decode_list(n, max_error, body, pair, MOTION if moved else None)


def parts(points: Points, rng: np.random.Generator) -> dict[str, Points]:
    """What filters, splitters and mergers of others make of a scan."""
    turned = points @ np.array([[0.8, -0.6, 0], [0.6, 0.8, 0], [0, 0, 1]], np.float32) + np.float32(0.4)
    _, first = np.unique(np.floor(points / 0.3).astype(np.int64), axis=0, return_index=True)
    return {
        "half of them": points[rng.random(len(points)) < 0.5],
        "shuffled": points[rng.permutation(len(points))],
        "no ground": points[points[:, 2] > -1.2],
        "a part of a turn": points[np.abs(points[:, 1]) < points[:, 0]],
        "near": points[np.linalg.norm(points, axis=1) < 10],
        "one a voxel": points[np.sort(first)],
        "two sensors": np.vstack([points[: len(points) // 2], turned[: len(points) // 2]]),
        "a few": points[rng.permutation(len(points))[:640]],
    }


def assert_within(points: Points, max_error: float, sensor: SensorModel | None) -> None:
    points = np.ascontiguousarray(points)
    snapped = snap(points, max_error, sensor)
    data = np.frombuffer(
        bytearray(encode_list(np.arange(len(points)), plan(snapped, max_error, sensor))), np.uint8
    )
    _, decoded, _, sound = decode_list(len(points), max_error, data, sensor)
    assert sound
    assert decoded.tobytes() == snapped.tobytes()
    if len(points):
        assert np.linalg.norm(decoded.astype(np.float64) - points, axis=1).max() <= max_error


@settings(max_examples=25)
@given(st.data())
def test_any_part_of_any_cloud_within_any_bound(
    fan: SensorModel, sensor: SensorModel, rows: Points, data: st.DataObject
) -> None:
    """Which way codes a cloud is decided without asking which way codes it, whatever share of it lies on a lattice."""
    on = data.draw(st.floats(0.3, 1.0), label="share on the lattice")
    rng = np.random.default_rng(data.draw(st.integers(0, 99), label="seed"))
    points = in_order(rows, data.draw(st.sampled_from(["rows", "firings, returns"])))
    odd = rng.random(len(points)) > on
    points[odd] += rng.normal(0, 0.2, (int(odd.sum()), 3)).astype(np.float32)
    part = data.draw(st.sampled_from([*parts(points[:900], rng), "whole"]), label="part")
    points = points if part == "whole" else parts(points, rng)[part]
    max_error = data.draw(st.sampled_from([0.002, 0.005, 0.01, 0.02, 0.05, 0.3]), label="bound")
    assert_within(points, max_error, data.draw(st.sampled_from([fan, sensor, None]), label="model"))


@pytest.mark.parametrize("max_error", [0.005, 0.02, 0.05])
def test_parts_of_a_real_scan(real_data, sensor: SensorModel, max_error: float) -> None:
    file = real_data / "semantickitti" / "sequences" / "00" / "velodyne" / "000000.bin"
    points = np.ascontiguousarray(np.fromfile(file, "<f4").reshape(-1, 4)[:, :3])
    for part in parts(points, np.random.default_rng(0)).values():
        assert_within(part, max_error, sensor)
