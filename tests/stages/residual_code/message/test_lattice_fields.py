"""Fields that follow from laser, firing and column: exact, whatever they hold, and in next to no bits where they do follow."""

import os
import subprocess
import sys
import zlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from salpcc.schemas.errors import ArchiveError
from salpcc.stages.entropy.number_forms import from_spans, spans_of
from salpcc.stages.lattice.drivers import FORMULAS, Driver
from salpcc.stages.lattice.lattice import driven, unproject
from salpcc.stages.lattice.sensor_model import SensorModel, with_driver
from salpcc.stages.residual_code.message.blended_values import MOST, decode_blended, encode_blended
from salpcc.stages.residual_code.message.field_coder import decode_field, encode_field
from salpcc.stages.residual_code.message.points import Points
from salpcc.stages.residual_code.message.records import BLENDED, BY_LASER, COLUMNS, CONSTANT, TIMES

LASERS, FIRINGS = 16, 400
ORDER = np.array([0, 8, 1, 9, 2, 10, 3, 11, 4, 12, 5, 13, 6, 14, 7, 15])  # as lasers fire
FIRED, DELAY = 55_296, 2_304  # ns


def sensor() -> SensorModel:
    zero = np.zeros(LASERS)
    theta = np.radians(np.linspace(15, -15, LASERS))
    return SensorModel("x", 36_000, 0.002, theta, zero, zero, zero, zero, zero.astype(np.int64))


@pytest.fixture(scope="module")
def listed() -> tuple[Points, np.ndarray, np.ndarray]:
    """Points of a turn as they fired, a tenth without a return; their lasers, and times in ns: packets are stamped to 1 us."""
    rng = np.random.default_rng(0)
    laser, firing = np.tile(ORDER, FIRINGS), np.repeat(np.arange(FIRINGS), LASERS)
    tick = (firing * 20 + rng.integers(0, 2, FIRINGS)[firing]) % 36_000
    stamp = rng.integers(-3, 4, FIRINGS // 24 + 1)[firing // 24] * 1000
    time = firing * FIRED + stamp + DELAY * np.argsort(ORDER)[laser] + 7_000
    count = np.rint((8.0 + 3.0 * np.sin(tick / 4000) + rng.normal(0, 0.02, len(tick))) / 0.002)
    xyz = unproject(sensor(), laser.astype(np.uint8), tick.astype(np.int32), count).astype(np.float32)
    seen = rng.random(len(tick)) < 0.9
    return Points.of(xyz[seen], 0, sensor()), laser[seen], time[seen]


def coded(values: np.ndarray, points: Points) -> bytes:
    data = encode_field(values, points)
    back, end = decode_field(data, 0, values.dtype, points)
    assert end == len(data)
    assert back.tobytes() == values.tobytes()
    return data


@pytest.mark.parametrize("formula", ["nebula", "hesai", None])
def test_distances_and_azimuths_are_those_of_the_driver(formula: str | None) -> None:
    """Whatever multiples they also are: a billionth divides every float32 above a few centimetres."""
    rng = np.random.default_rng(4)
    offset = (
        np.radians(np.linspace(-3, 3, LASERS)).astype(np.float32)
        if formula == "hesai"
        else np.zeros(LASERS, np.float32)
    )
    rows = [FORMULAS[formula or "hesai"].row(0, angle) for angle in offset]
    bare = sensor()
    lasers = np.column_stack([np.cos(bare.theta), np.sin(bare.theta), rows]).astype(np.float32)
    told = with_driver(bare, Driver(formula or "hesai", "rounded", True, lasers))
    laser, index = np.tile(ORDER, FIRINGS), np.repeat(np.arange(FIRINGS) * 20, LASERS)
    count = rng.integers(300, 20_000, len(laser))
    xyz = driven(told, laser.astype(np.uint8), ((36_000 - index) % 36_000).astype(np.int32), count).astype(
        np.float32
    )
    xyz[::200] = rng.uniform(0.5, 9, (len(xyz[::200]), 3))  # off the lattice
    points = Points.of(xyz, 0, told if formula else None)
    distance = count.astype(np.float32) * np.float32(0.002)
    azimuth = (index * 0.01 * np.pi / 180).astype(np.float32) + offset[laser]
    sizes = [
        8 * len(coded(values, points)) / len(values)
        for values in (distance, azimuth, azimuth.astype(np.float64))
    ]
    assert sizes[0] < (1.0 if formula else 4.0)
    if formula:
        assert sizes[1] < 1.0
        assert sizes[2] < 1.5
        record = encode_field(distance, points)
        with pytest.raises(ArchiveError):
            decode_field(record, 0, distance.dtype, Points.of(xyz, 0, None))


def test_ranges_are_counts_where_beams_start_beside_the_axis() -> None:
    rng = np.random.default_rng(5)
    levers = replace(sensor(), h=np.full(LASERS, 0.02), d0=np.linspace(-0.03, 0.03, LASERS))
    laser, tick = np.tile(ORDER, FIRINGS).astype(np.uint8), np.repeat(np.arange(FIRINGS) * 20, LASERS)
    count = rng.integers(300, 20_000, len(laser))
    xyz = unproject(levers, laser, tick.astype(np.int32), count).astype(np.float32)
    xyz[::100] = 0
    millimetres = np.where(xyz.any(axis=1), 2 * count, 0).astype(np.uint32)
    record = coded(millimetres, Points.of(xyz, 0, levers))
    assert 8 * len(record) < 0.1 * len(millimetres)
    assert len(record) < 0.2 * len(coded(millimetres, Points.of(xyz, 0, sensor())))
    with pytest.raises(ArchiveError):
        decode_field(record, 0, millimetres.dtype, Points.of(xyz, 0, None))


def test_rings_cost_nothing(listed) -> None:
    points, laser, _ = listed
    for ring in (laser.astype(np.uint16), (2 * (15 - laser) + 100).astype(np.uint8)):
        data = coded(ring, points)
        assert data[0] == BY_LASER
        assert 8 * len(data) < 0.06 * len(ring)


@pytest.mark.parametrize(
    "of",
    [
        lambda t: (t / 1e9).astype(np.float32),
        lambda t: (t / 1e6).astype(np.float32),
        lambda t: 1_700_000_000.0 + t / 1e9,
        lambda t: (t / 1e3 + 1.7e15).astype(np.float64),
        lambda t: t.astype(np.uint32),
        lambda t: t.astype(np.int32) - 100_000,
        lambda t: t.astype(np.int64).astype(np.float64) / 1e9,
    ],
    ids=["f4 s", "f4 ms", "f8 unix s", "f8 unix us", "u4 ns", "i4 ns", "f8 s"],
)
def test_times_follow_from_the_firing(listed, of) -> None:
    points, _, time = listed
    data = coded(of(time), points)
    assert 8 * len(data) < 0.7 * len(time)


def pictured(points: Points, noise: float) -> np.ndarray:
    """Intensities of walls: alike where distances are, and noise."""
    wall = 60.0 + 40.0 * np.sign(np.sin(points.ranges * 9.0))
    return np.clip(wall + np.random.default_rng(2).normal(0, noise, len(wall)), 0, 255)


@pytest.mark.parametrize("kind", ["u1", "u2", "f4", "i4"])
def test_intensities_follow_from_what_lies_around(listed, kind: str) -> None:
    points, _, _ = listed
    values = np.rint(pictured(points, 2.0)).astype(kind)
    data = coded(values, points)
    assert data[0] == BLENDED
    assert 8 * len(data) < 5.4 * len(values)  # by what came before in the list, 6.3
    hundredths = (values / 100).astype(np.float32)
    assert coded(hundredths, points)[0] == BLENDED


def test_intensities_of_rows_and_of_lists() -> None:
    rng = np.random.default_rng(0)
    rows, width = 32, 256
    distance = np.tile(rng.uniform(4.0, 9.0, width), rows) + rng.normal(0, 0.005, rows * width)
    xyz = np.stack([distance, 0 * distance, 0 * distance], axis=1).astype(np.float32)
    xyz[rng.random(len(xyz)) < 0.2] = 0
    sizes = []
    for points in (Points.of(xyz, width), Points.of(xyz, 0)):
        values = np.where(points.void, 0, pictured(points, 3.0)).astype(np.uint16)
        sizes.append(len(coded(values, points)))
    assert sizes[0] < 0.9 * sizes[1]


def test_intensities_follow_from_reflectivities(listed) -> None:
    points, _, _ = listed
    rng = np.random.default_rng(0)
    shine = rng.integers(1, 60, len(points.xyz))
    values = (
        np.rint(40.0 * shine / points.ranges**2 + rng.normal(0, 0.3, len(shine))).clip(0).astype(np.float32)
    )
    sizes = [len(coded(values, known)) for known in (points, replace(points, guide=shine))]
    assert sizes[1] < 0.75 * sizes[0]
    wild = rng.integers(-(1 << 62), 1 << 62, len(shine))
    coded(values, replace(points, guide=wild))


@pytest.mark.parametrize("width", [0, 64])
def test_any_numbers_are_blended_and_back(width: int) -> None:
    rng = np.random.default_rng(width)
    xyz = rng.uniform(1e-3, 9, (64 * 40, 3)).astype(np.float32)
    xyz[rng.random(len(xyz)) < 0.3] = 0
    points = Points.of(xyz, width)
    around = points.around(2 if width else 0)
    assert around is not None
    for most in (1, 255, 70_000, MOST - 1):
        values = rng.integers(-most, most + 1, len(xyz))
        back, sound = decode_blended(around, encode_blended(values, around))
        assert sound
        assert (back == values).all()


def test_two_returns_of_a_laser_have_one_time(listed) -> None:
    points, _, time = listed
    twice = np.repeat(np.arange(len(time)), 1 + np.random.default_rng(1).integers(0, 2, len(time)))
    both = Points.of(points.xyz[twice], 0, points.sensor)
    data = coded((time[twice] / 1e9).astype(np.float32), both)
    assert data[0] == TIMES
    assert 8 * len(data) < 0.5 * len(twice)


@pytest.mark.parametrize("void", ["timed", "zero"])
def test_times_of_columns(void: str) -> None:
    """Rows are shifted, as sensors do that turn their columns upright."""
    rng = np.random.default_rng(0)
    rows, width = 16, 256
    times = np.cumsum(97_656 + rng.integers(-900, 900, width)).astype(np.uint32)
    at = (np.arange(width) + 12 * (np.arange(rows)[:, None] % 4)) % width
    values = times[at].ravel()
    xyz = rng.uniform(1, 9, (rows * width, 3)).astype(np.float32)
    gone = rng.random(rows * width) < 0.3
    xyz[gone] = 0
    if void == "zero":
        values[gone] = 0
    data = coded(values, Points.of(xyz, width))
    assert data[0] == COLUMNS
    assert 8 * len(data) < 2.0 * len(values)


@settings(max_examples=60)
@given(st.data())
def test_anything_comes_back(listed, data: st.DataObject) -> None:
    points, laser, time = listed
    kind = np.dtype(data.draw(st.sampled_from(["i1", "u1", "u2", "i4", "u4", "i8", "u8", "f4", "f8"])))
    rng = np.random.default_rng(data.draw(st.integers(0, 99)))
    with np.errstate(all="ignore"):
        values = data.draw(st.sampled_from([time / 1e9, time * 1.0, laser * 1.0, -time * 1e30])).astype(kind)
    bits = values.view(f"u{kind.itemsize}")
    some = rng.random(len(bits)) < data.draw(st.sampled_from([0.0, 0.01, 1.0]))
    bits[some] = rng.integers(0, 1 << min(8 * kind.itemsize, 63), some.sum())
    coded(values, points)


@pytest.mark.parametrize("kind", ["f4", "f8", "u4"])
def test_spans_hold_what_they_mean(kind: str) -> None:
    values = (np.random.default_rng(0).uniform(0, 0.1, 2000) * (1e9 if kind == "u4" else 1)).astype(kind)
    if kind == "f8":
        values += 1.7e9
    spans = spans_of(values)
    assert spans is not None
    for end in (spans.low, spans.high):
        assert (from_spans(end, spans.form, spans.power, spans.origin, values.dtype) == values).all()


def test_damage_is_an_error_or_other_values(listed) -> None:
    points, laser, time = listed
    rng = np.random.default_rng(0)
    seen = np.rint(pictured(points, 3.0)).astype(np.uint8)
    for values in (laser.astype(np.uint8), (time / 1e9).astype(np.float32), seen):
        data = encode_field(values, points)
        assert data[0] != CONSTANT
        for _ in range(60):
            bad = bytearray(data[: rng.integers(1, len(data) + 1)])
            bad[rng.integers(0, min(len(bad), 60))] ^= 1 << rng.integers(0, 8)
            try:
                back, _ = decode_field(bytes(bad), 0, values.dtype, points)
            except ArchiveError:
                continue
            assert len(back) == len(values)


_SCRIPT = """
import sys, zlib, numpy as np
sys.path.insert(0, sys.argv[1])
from test_lattice_fields import sensor
from salpcc.stages.residual_code.message.field_coder import decode_field
from salpcc.stages.residual_code.message.points import Points
held = np.load(sys.argv[2])
points = Points.of(held["xyz"], 0, sensor())
values, _ = decode_field(held["data"].tobytes(), 0, np.dtype(np.float32), points)
print(zlib.crc32(values.tobytes()) == int(held["crc"]))
"""


def test_a_plain_processor_reads_the_same(listed, tmp_path: Path) -> None:
    points, _, time = listed
    values = (time / 1e9).astype(np.float32)
    data = np.frombuffer(encode_field(values, points), np.uint8)
    np.savez(tmp_path / "held.npz", xyz=points.xyz, data=data, crc=zlib.crc32(values.tobytes()))
    environment = os.environ | {
        "NUMBA_CPU_NAME": "generic",
        "NUMBA_CPU_FEATURES": "",
    }  # numba keeps kernels by these
    command = [sys.executable, "-c", _SCRIPT, str(Path(__file__).parent), str(tmp_path / "held.npz")]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.stdout.strip() == "True", done.stderr
