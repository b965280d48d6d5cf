"""Fields as efforts above ``fast`` learn them: to the bit, in fewer bits, through the scans of a group."""

from dataclasses import replace

import numpy as np
import pytest

from salpcc.schemas.errors import ArchiveError
from salpcc.stages.lattice.lattice import unproject
from salpcc.stages.lattice.sensor_model import SensorModel
from salpcc.stages.residual_code.gop import decode_gop, encode_gop
from salpcc.stages.residual_code.message.field_coder import decode_field
from salpcc.stages.residual_code.message.field_modes import FieldModes
from salpcc.stages.residual_code.message.points import Points
from salpcc.stages.residual_code.message.records import LEARNED

LASERS, FIRINGS, WIDTH = 16, 250, 600
NAME = ("/a", "intensity")


def sensor() -> SensorModel:
    zero = np.zeros(LASERS)
    theta = np.radians(np.linspace(15, -15, LASERS))
    return SensorModel("x", 36_000, 0.002, theta, zero, zero, zero, zero, zero.astype(np.int64))


def scan(seed: int, width: int = 0) -> tuple[Points, np.ndarray]:
    """Walls that shine here and there, as they were fired or in rows, some without a return."""
    rng = np.random.default_rng(seed)
    laser, firing = np.tile(np.arange(LASERS), FIRINGS), np.repeat(np.arange(FIRINGS), LASERS)
    if width:
        laser, firing = np.repeat(np.arange(LASERS), width), np.tile(np.arange(width), LASERS)
    side = np.sign(np.sin(firing / 4.0 + laser))
    count = np.rint((8.0 + side + np.sin(firing / 9) + rng.normal(0, 0.01, len(laser))) / 0.002)
    xyz = unproject(sensor(), laser.astype(np.uint8), (firing * 60).astype(np.int32), count).astype(
        np.float32
    )
    wall = 60.0 + 40.0 * side + 9.0 * np.sin(firing / 3.0) * np.cos(laser / 2.0)
    values = np.rint((wall + rng.normal(0, 1.5, len(wall))).clip(0, 255)).astype(np.float32)
    seen = rng.random(len(laser)) < 0.9
    if not width:
        return Points.of(xyz[seen], 0, sensor()), values[seen]
    xyz[~seen], values[~seen] = 0, 0
    return Points.of(xyz, width), values


def group(scans: list[tuple[Points, np.ndarray]], learns: bool) -> list[int]:
    """Bytes that the field takes scan by scan; it must come back."""
    writer, reader, sizes = FieldModes(learns), FieldModes(), []
    for points, values in scans:
        record = writer.encode(NAME, values, points)
        assert (record[0] == LEARNED) == learns
        back, end = reader.decode(NAME, record, 0, values.dtype, points)
        assert end == len(record)
        assert back.tobytes() == values.tobytes()
        sizes.append(len(record))
    return sizes


@pytest.mark.parametrize("width", [0, WIDTH])
def test_takes_fewer_bits_and_learns_from_the_scan_before(width: int) -> None:
    scans = [scan(seed, width) for seed in range(3)]
    plain, learned = group(scans, False), group(scans, True)
    assert learned[0] < 0.95 * plain[0]
    assert learned[2] < 0.8 * plain[2]


def test_any_numbers_come_back() -> None:
    rng = np.random.default_rng(0)
    points, values = scan(0)
    wild = [
        (points, values),
        (
            points,
            np.rint(np.exp(rng.uniform(0, 22, len(values))) * rng.choice([-1, 1], len(values))).astype(
                np.int64
            ),
        ),
        (scan(1)[0], scan(1)[1]),
    ]
    writer, reader = FieldModes(True), FieldModes()
    for known, of in wild:
        guided = replace(known, guide=rng.integers(-(1 << 62), 1 << 62, len(of)))
        record = writer.encode(NAME, of, guided)
        assert reader.decode(NAME, record, 0, of.dtype, guided)[0].tobytes() == of.tobytes()


def test_damaged_records_are_told() -> None:
    points, values = scan(0)
    record = FieldModes(True).encode(NAME, values, points)
    rng = np.random.default_rng(0)
    for _ in range(40):
        data = bytearray(record)
        for _ in range(3):
            data[rng.integers(8, len(data))] ^= int(rng.integers(1, 256))
        try:
            back, _ = FieldModes().decode(NAME, bytes(data), 0, values.dtype, points)
        except ArchiveError:
            continue
        assert len(back) == len(values)
    with pytest.raises(ArchiveError):
        decode_field(record, 0, values.dtype, points)  # nothing is known of what was learned


@pytest.mark.parametrize("name", ["vlp16_tier4", "hesai_xt32m"])
def test_recordings_take_a_tenth_less_at_default(name: str, real_sweeps) -> None:  # type: ignore[no-untyped-def]
    model, sweeps = real_sweeps(name)
    sizes = {}
    for effort in ("fast", "default", "max"):
        coded = encode_gop(sweeps, model, effort)
        sizes[effort] = sum(len(payload.data) for payload in coded)
        for sweep, back in zip(sweeps, decode_gop([payload.data for payload in coded], model), strict=True):
            assert back.stray_points.tobytes() == sweep.stray_points.tobytes()
            assert back.cloud.rest.tobytes() == sweep.cloud.rest.tobytes()
    assert sizes["default"] < 0.9 * sizes["fast"]
    assert sizes["max"] <= sizes["default"]


@pytest.fixture
def real_sweeps(real_data):  # type: ignore[no-untyped-def]
    """Sensor and first two sweeps of a recording."""
    from salpcc.pipeline.sensors.choose_sensor import choose_sensor
    from salpcc.stages.ingest.sources.bag import Bag
    from salpcc.stages.ingest.stage import Projector
    from salpcc.stages.lattice.sensor_model import load_sensor

    def read(name: str):  # type: ignore[no-untyped-def]
        log = real_data / "sensors" / f"{name}.mcap"
        model = load_sensor(choose_sensor(log, name, ()).name)
        bag, project = Bag(), Projector(model)
        refs = bag.scans(log, name, ())[:2]
        return model, [project(ref.number, bag.read(ref, with_labels=False)) for ref in refs]

    return read
