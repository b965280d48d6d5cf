"""Effort ``fast``: exact inverse for all levels and steps, safe on damaged data, tables counted from sweeps."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from salpcc.schemas.errors import SalpccError, UsageError
from salpcc.schemas.scan import Scan
from salpcc.schemas.sweep import Sweep
from salpcc.stages.lattice.sensor_model import SensorModel
from salpcc.stages.lattice.sweep import scan_to_sweep
from salpcc.stages.predict.ring_starts import ring_starts
from salpcc.stages.predict.static import coder
from salpcc.stages.predict.static.count_tables import STEPS, load_tables, save_tables, shipped, table_of
from salpcc.stages.predict.static.tokens import ESCAPE
from salpcc.stages.predict.static.train import to_frequencies, train_tables


@pytest.fixture(scope="module")
def sweep(make_scan: Callable[..., Scan], sensor: SensorModel) -> Sweep:
    return scan_to_sweep(make_scan(seed=3, stride=8, motion=None), sensor)


def bytes_of(data: bytes) -> np.ndarray:
    return np.frombuffer(bytearray(data), np.uint8)


def levels(sweep: Sweep, step: int, sensor: SensorModel) -> bytes:
    starts = ring_starts(sweep.laser, sensor.n_lasers)
    found = coder.level_contexts(starts, sweep.tick, sweep.count // step, step, sensor)
    return coder.encode_levels(*found, step, shipped())


def read_levels(sweep: Sweep, step: int, sensor: SensorModel, data: bytes) -> tuple[np.ndarray, bool]:
    starts = ring_starts(sweep.laser, sensor.n_lasers)
    return coder.decode_levels(starts, sweep.tick, step, sensor, shipped(), bytes_of(data))


def values(sweep: Sweep, sensor: SensorModel, value: np.ndarray) -> bytes:
    starts = ring_starts(sweep.laser, sensor.n_lasers)
    context = coder.intensity_contexts(starts, sweep.tick, sweep.count, value)
    return coder.encode_intensities(context, value, shipped())


def read_values(sweep: Sweep, sensor: SensorModel, data: bytes) -> tuple[np.ndarray, bool]:
    starts = ring_starts(sweep.laser, sensor.n_lasers)
    return coder.decode_intensities(starts, sweep.tick, sweep.count, shipped(), bytes_of(data))


@pytest.mark.parametrize("step", [1, 2, 5, 10, 20, 333, 65535])
def test_levels_come_back(sweep: Sweep, sensor: SensorModel, step: int) -> None:
    level, sound = read_levels(sweep, step, sensor, levels(sweep, step, sensor))
    assert sound
    np.testing.assert_array_equal(level, sweep.count // step)


@pytest.mark.parametrize("largest", [1, 1 << 20])
def test_any_levels_come_back(sweep: Sweep, sensor: SensorModel, largest: int) -> None:
    rng = np.random.default_rng(1)
    wild = replace(sweep, count=rng.integers(0, largest, len(sweep.tick)).astype(np.int32))
    level, sound = read_levels(wild, 1, sensor, levels(wild, 1, sensor))
    assert sound
    np.testing.assert_array_equal(level, wild.count)


def test_surfaces_cost_little(sweep: Sweep, sensor: SensorModel) -> None:
    """1 cm of noise costs 4.4 bits at 2 mm; every eighth firing of a wavy wall may add some, not eleven."""
    assert 8 * len(levels(sweep, 1, sensor)) / len(sweep.tick) < 9.0


@pytest.mark.parametrize("wild", [False, True])
def test_intensities_come_back(sweep: Sweep, sensor: SensorModel, wild: bool) -> None:
    value = np.rint(sweep.intensity * 100).astype(np.uint8)
    if wild:
        value = np.random.default_rng(1).integers(0, 101, len(value)).astype(np.uint8)
    data = values(sweep, sensor, value)
    back, sound = read_values(sweep, sensor, data)
    assert sound
    np.testing.assert_array_equal(back, value)


@pytest.mark.parametrize("n", [0, 1])
def test_hardly_any_returns(sensor: SensorModel, sweep: Sweep, n: int) -> None:
    few = replace(sweep, laser=np.full(n, 40, np.uint8), tick=sweep.tick[:n], count=sweep.count[:n])
    level, sound = read_levels(few, 1, sensor, levels(few, 1, sensor))
    assert sound
    np.testing.assert_array_equal(level, few.count)
    back, sound = read_values(few, sensor, values(few, sensor, np.full(n, 100, np.uint8)))
    assert sound
    assert (back == 100).all()


def test_damage_never_leaves_the_bounds(sweep: Sweep, sensor: SensorModel) -> None:
    value = np.rint(sweep.intensity * 100).astype(np.uint8)
    rng = np.random.default_rng(7)
    for good, read in (
        (levels(sweep, 5, sensor), lambda data: read_levels(sweep, 5, sensor, data)),
        (values(sweep, sensor, value), lambda data: read_values(sweep, sensor, data)),
    ):
        for trial in range(12):
            bad = bytearray(good)
            bad[rng.integers(0, len(bad))] ^= int(rng.integers(1, 256))
            if trial % 3 == 0:
                bad = bad[: rng.integers(0, len(bad))]
            found, sound = read(bytes(bad))
            assert not sound or len(bad) == len(good)  # flipped even bits are for checksums
            assert found.min() >= 0
            assert found.max() < 1 << 20


def test_a_sensor_of_odd_numbers_is_coded_all_the_same(sweep: Sweep, sensor: SensorModel) -> None:
    odd = replace(sensor, theta=sensor.theta + 1.5, d0=sensor.d0 - 9.0, h=sensor.h + 5.0, count=1e-9)
    level, sound = read_levels(sweep, 1, odd, levels(sweep, 1, odd))
    assert sound
    np.testing.assert_array_equal(level, sweep.count)


def test_tables_follow_the_sweeps_they_are_counted_from(
    sweep: Sweep, sensor: SensorModel, tmp_path: Path
) -> None:
    path = train_tables([sweep], sensor, tmp_path, lambda _: None)
    again = train_tables([sweep], sensor, tmp_path / "again", lambda _: None)
    own = load_tables(path)
    assert own.digest == load_tables(again).digest != shipped().digest
    starts = ring_starts(sweep.laser, sensor.n_lasers)
    found = coder.level_contexts(starts, sweep.tick, sweep.count, 1, sensor)
    assert len(coder.encode_levels(*found, 1, own)) < len(coder.encode_levels(*found, 1, shipped()))
    with pytest.raises(UsageError, match="no sweeps"):
        train_tables([], sensor, tmp_path, lambda _: None)


def test_frequencies_add_up_and_leave_the_rare_to_the_escape() -> None:
    counts = np.zeros((3, 65), np.int64)
    counts[0, :3] = 10**6, 10, 10**6
    counts[1, 5] = 1
    frequency = to_frequencies(counts)
    assert (frequency.sum(1) == 4096).all()
    assert (frequency[:, ESCAPE] >= 1).all()
    assert frequency[0, 1] == 0


def test_every_step_has_a_table() -> None:
    assert [table_of(step) for step in (1, 2, 7, 8, 14, 15, 65535)] == [0, 1, 1, 2, 2, 3, 3]
    assert len(shipped().levels) == len(STEPS)


def test_damaged_tables_are_refused(tmp_path: Path) -> None:
    wrong = replace(shipped(), levels=shipped().levels[:, :, ::-1].copy() + np.uint16(1))
    save_tables(tmp_path / "fast.npz", wrong)
    with pytest.raises(SalpccError, match="not tables"):
        load_tables(tmp_path / "fast.npz")
