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
from salpcc.stages.predict.static.symbols import pop_symbol, starts_of
from salpcc.stages.predict.static.tokens import ESCAPE
from salpcc.stages.predict.static.train import to_frequencies, train_tables
from salpcc.stages.predict.static.waves import LAG, waves
from salpcc.stages.vectors import kernel


@pytest.fixture(scope="module")
def sweep(make_scan: Callable[..., Scan], sensor: SensorModel) -> Sweep:
    return scan_to_sweep(make_scan(seed=3, stride=8, motion=None), sensor)


def bytes_of(data: bytes) -> np.ndarray:
    return np.frombuffer(bytearray(data), np.uint8)


def written(sweep: Sweep, step: int, sensor: SensorModel, value: np.ndarray) -> tuple[bytes, bytes]:
    """The streams of levels and of intensities ``value``."""
    starts = ring_starts(sweep.laser, sensor.n_lasers)
    found = coder.contexts(starts, sweep.tick, sweep.count // step, step, sensor, value)
    return (
        coder.encode_levels(found.order, found.of_levels, found.residual, step, shipped()),
        coder.encode_intensities(found.order, found.of_values, value, shipped()),
    )


def read(
    sweep: Sweep, step: int, sensor: SensorModel, levels: bytes, intensities: bytes | None
) -> tuple[np.ndarray, np.ndarray, bool]:
    starts = ring_starts(sweep.laser, sensor.n_lasers)
    of_values = None if intensities is None else bytes_of(intensities)
    return coder.decode(starts, sweep.tick, step, sensor, shipped(), bytes_of(levels), of_values)


def hundredths(sweep: Sweep) -> np.ndarray:
    return np.rint(sweep.intensity * 100).astype(np.uint8)


@pytest.mark.parametrize("step", [1, 2, 5, 10, 20, 333, 65535])
def test_levels_and_intensities_come_back(sweep: Sweep, sensor: SensorModel, step: int) -> None:
    level, value, sound = read(sweep, step, sensor, *written(sweep, step, sensor, hundredths(sweep)))
    assert sound
    np.testing.assert_array_equal(level, sweep.count // step)
    np.testing.assert_array_equal(value, hundredths(sweep))


def test_levels_come_back_alone(sweep: Sweep, sensor: SensorModel) -> None:
    """Where intensities are no hundredths; what their contexts are changes nothing of the levels' stream."""
    starts = ring_starts(sweep.laser, sensor.n_lasers)
    found = coder.contexts(starts, sweep.tick, sweep.count, 1, sensor)
    alone = coder.encode_levels(found.order, found.of_levels, found.residual, 1, shipped())
    assert alone == written(sweep, 1, sensor, hundredths(sweep))[0]
    level, value, sound = read(sweep, 1, sensor, alone, None)
    assert sound
    assert len(value) == 0
    np.testing.assert_array_equal(level, sweep.count)


@pytest.mark.parametrize("largest", [1, 1 << 20])
def test_any_values_come_back(sweep: Sweep, sensor: SensorModel, largest: int) -> None:
    rng = np.random.default_rng(1)
    wild = replace(sweep, count=rng.integers(0, largest, len(sweep.tick)).astype(np.int32))
    some = rng.integers(0, 101, len(sweep.tick)).astype(np.uint8)
    level, value, sound = read(wild, 1, sensor, *written(wild, 1, sensor, some))
    assert sound
    np.testing.assert_array_equal(level, wild.count)
    np.testing.assert_array_equal(value, some)


def test_rings_that_saw_little_come_back(sweep: Sweep, sensor: SensorModel) -> None:
    """Rings are walked side by side: of any size, and none at all."""
    rng = np.random.default_rng(2)
    kept = (
        rng.random(len(sweep.tick)) < np.array([0.0, 1.0, 0.01, 0.0, 0.0, 0.5, 1.0, 0.002])[sweep.laser % 8]
    )
    few = replace(sweep, laser=sweep.laser[kept], tick=sweep.tick[kept], count=sweep.count[kept])
    some = hundredths(sweep)[kept]
    level, value, sound = read(few, 1, sensor, *written(few, 1, sensor, some))
    assert sound
    np.testing.assert_array_equal(level, few.count)
    np.testing.assert_array_equal(value, some)


def test_waves_wait_for_what_they_need(sweep: Sweep, sensor: SensorModel) -> None:
    """Every return once; before it all of its ring that are before it, and of the ring above all up to LAG ticks ahead."""
    kept = np.random.default_rng(3).random(len(sweep.tick)) < 0.6
    laser, tick = sweep.laser[kept], sweep.tick[kept]
    starts = ring_starts(laser, sensor.n_lasers)
    order, ends = waves(starts, tick)
    first = starts[np.flatnonzero(np.diff(starts))]
    at, begin = first.copy(), 0
    for end in ends:
        wave = order[begin:end].astype(int)
        assert len(wave) and (np.diff(wave) > 0).all()
        for ring in wave[wave > 0]:
            left = tick[at[ring - 1] : first[ring]]
            assert not (left < tick[at[ring]] + LAG).any()
        at[wave] += 1
        begin = end
    assert begin == len(tick) == len(order)
    np.testing.assert_array_equal(at, np.append(first[1:], len(tick)))


def test_surfaces_cost_little(sweep: Sweep, sensor: SensorModel) -> None:
    """1 cm of noise costs 4.4 bits at 2 mm; every eighth firing of a wavy wall may add some, not eleven."""
    levels, _ = written(sweep, 1, sensor, hundredths(sweep))
    assert 8 * len(levels) / len(sweep.tick) < 9.0


@pytest.mark.parametrize("n", [0, 1])
def test_hardly_any_returns(sensor: SensorModel, sweep: Sweep, n: int) -> None:
    few = replace(sweep, laser=np.full(n, 40, np.uint8), tick=sweep.tick[:n], count=sweep.count[:n])
    data = written(few, 1, sensor, np.full(n, 100, np.uint8))
    level, value, sound = read(few, 1, sensor, *data)
    assert sound
    np.testing.assert_array_equal(level, few.count)
    np.testing.assert_array_equal(value, np.full(n, 100))
    assert not read(few, 1, sensor, data[0], b"")[2]


def test_damage_never_leaves_the_bounds(sweep: Sweep, sensor: SensorModel) -> None:
    good = written(sweep, 5, sensor, hundredths(sweep))
    rng = np.random.default_rng(7)
    for trial in range(24):
        bad = [bytearray(stream) for stream in good]
        which = bad[trial % 2]
        which[rng.integers(0, len(which))] ^= int(rng.integers(1, 256))
        if trial % 3 == 0:
            del which[rng.integers(0, len(which)) :]
        level, value, sound = read(sweep, 5, sensor, *map(bytes, bad))
        assert not sound or len(which) == len(good[trial % 2])  # flipped even bits are for checksums
        assert level.min() >= 0
        assert level.max() < 1 << 20
        assert not sound or value.max() <= 100


def test_a_sensor_of_odd_numbers_is_coded_all_the_same(sweep: Sweep, sensor: SensorModel) -> None:
    odd = replace(sensor, theta=sensor.theta + 1.5, d0=sensor.d0 - 9.0, h=sensor.h + 5.0, count=1e-9)
    level, _, sound = read(sweep, 1, odd, *written(sweep, 1, odd, hundredths(sweep)))
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
    found = coder.contexts(starts, sweep.tick, sweep.count, 1, sensor)
    sizes = [
        len(coder.encode_levels(found.order, found.of_levels, found.residual, 1, t)) for t in (own, shipped())
    ]
    assert sizes[0] < sizes[1]
    with pytest.raises(UsageError, match="no scans to train on"):
        train_tables([], sensor, tmp_path, lambda _: None)


def test_frequencies_add_up_and_leave_the_rare_to_the_escape() -> None:
    counts = np.zeros((3, 65), np.int64)
    counts[0, :3] = 10**6, 10, 10**6
    counts[1, 5] = 1
    frequency = to_frequencies(counts)
    assert (frequency.sum(1) == 4096).all()
    assert (frequency[:, ESCAPE] >= 1).all()
    assert frequency[0, 1] == 0


def test_a_symbol_is_found_by_its_slot() -> None:
    """Also next to symbols that never occur; the beginnings of every context are those that an encoder looks up."""
    frequency = np.zeros((2, 102), np.uint16)
    frequency[0, [0, 63, 64, 65, 101]] = 1, 4000, 5, 80, 10
    frequency[1, 100:] = 4095, 1
    starts = starts_of(frequency)
    expected = np.array([np.repeat(np.arange(102), row) for row in frequency])
    for context in range(2):
        found = [_popped(slot | 1 << 31, context, starts)[0] for slot in range(4096)]
        np.testing.assert_array_equal(found, expected[context])
    with pytest.raises(ValueError, match="add up"):
        starts_of(frequency[:, :3])


@kernel
def _popped(x, context, starts):
    return pop_symbol(x, context, starts, 2)


def test_every_step_has_a_table() -> None:
    assert [table_of(step) for step in (1, 2, 7, 8, 14, 15, 65535)] == [0, 1, 1, 2, 2, 3, 3]
    assert len(shipped().levels) == len(STEPS)


def test_damaged_tables_are_refused(tmp_path: Path) -> None:
    wrong = replace(shipped(), levels=shipped().levels[:, :, ::-1].copy() + np.uint16(1))
    save_tables(tmp_path / "fast.npz", wrong)
    with pytest.raises(SalpccError, match="not tables"):
        load_tables(tmp_path / "fast.npz")
