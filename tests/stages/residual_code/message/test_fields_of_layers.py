"""Fields of the two layers of a cloud: times of firings and columns are known from the static layer."""

import numpy as np
import pytest
from numpy.typing import NDArray

from salpcc.schemas.errors import ArchiveError
from salpcc.stages.residual_code.message.field_coder import decode_field, encode_field, encode_like
from salpcc.stages.residual_code.message.firing_times import (
    Clocked,
    Fired,
    decode_times,
    encode_times,
    find_times,
)
from salpcc.stages.residual_code.message.points import Points
from salpcc.stages.residual_code.message.ranks import encode_ranks
from salpcc.stages.residual_code.message.records import RANKS

LASERS, FIRINGS = 16, 400
I64 = NDArray[np.int64]


def fired(seed: int = 0) -> tuple[Fired, I64, NDArray[np.bool_]]:
    """Firings with gaps of lasers in turn, their times, and which are known: all but those of some things."""
    rng = np.random.default_rng(seed)
    laser, firing = np.tile(np.arange(LASERS), FIRINGS), np.repeat(np.arange(FIRINGS), LASERS)
    there = rng.random(len(laser)) < 0.8
    clock = np.cumsum(55296 + rng.integers(-3, 4, FIRINGS))
    time = clock[firing] + 2304 * laser
    known = ~(((firing // 40) % 3 == 1) & (laser > 4)) & ~((firing > 100) & (firing < 110))
    laser, firing, time, known = laser[there], firing[there], time[there], known[there]
    shift = np.zeros(LASERS + 1, np.int64)
    return Fired(laser, 2 * firing, shift, 4 * FIRINGS), time, known


@pytest.mark.parametrize("slack", [0, 700])
def test_known_times_tell_the_others(slack: int) -> None:
    """Of times that are known nothing is written, and those of their firings follow."""
    of, time, known = fired()
    low, high = time - slack, time + slack
    found = find_times(of, low, high, 1 << 20, known)
    assert found is not None
    clocked, data = found
    given = np.where(known, low, -1), np.where(known, high, -1), known
    back, sound = decode_times(of, clocked, data, given)
    assert sound
    assert ((low <= back) & (back <= high))[~known].all()
    alone = encode_times(of, low, high, clocked)
    assert alone is not None
    assert len(data) < 0.2 * len(alone) * np.mean(~known) + 60


def test_times_that_contradict_their_firing() -> None:
    """A point whose time is not that of its firing's known ones is told all the same."""
    of, time, known = fired(1)
    time = time.copy()
    time[::37] += 1000
    clocked = Clocked(False, 1, np.append(2304 * np.arange(LASERS), 0))
    data = encode_times(of, time, time, clocked, known=known)
    assert data is not None
    given = np.where(known, time, -1), np.where(known, time, -1), known
    back, sound = decode_times(of, clocked, data, given)
    assert sound
    assert (back == time)[~known].all()


def columns(rows: int = 32, width: int = 256) -> tuple[NDArray[np.uint32], NDArray[np.bool_]]:
    """Times of an organised cloud, a column's all the same, and which points of it are movable."""
    time = np.cumsum(np.random.default_rng(2).integers(97000, 99000, width)).astype(np.uint32)
    mask = np.zeros((rows, width), np.bool_)
    mask[4:20, 30:90] = mask[10:16, 200:250] = True
    return np.tile(time, rows), mask.ravel()


def test_times_of_columns_in_a_layer_are_ranks() -> None:
    time, mask = columns()
    static = time[~mask]
    points = Points.of(np.ones((len(static), 3), np.float32), 0)
    record = encode_field(static, points)
    assert record[0] == RANKS
    assert len(record) < len(static) // 8
    back, end = decode_field(record, 0, static.dtype, points)
    assert end == len(record)
    assert (back == static).all()
    assert encode_like(record, static, points) == record


@pytest.mark.parametrize(
    "values", [np.arange(4000, dtype=np.uint32), np.arange(4000, dtype=np.uint32) // 9 * 7]
)
def test_ranks_are_of_few_values_in_turn(values: NDArray[np.uint32]) -> None:
    assert encode_ranks(values, Points.of(np.ones((len(values), 3), np.float32), 0)) is None


def test_damaged_ranks_are_refused() -> None:
    time, mask = columns()
    static = time[~mask]
    points = Points.of(np.ones((len(static), 3), np.float32), 0)
    record = bytearray(encode_field(static, points))
    few = Points.of(np.ones((100, 3), np.float32), 0)
    with pytest.raises(ArchiveError):
        decode_field(bytes(record), 0, static.dtype, few)
    record[9:13] = (1 << 31).to_bytes(4, "little")
    with pytest.raises(ArchiveError):
        decode_field(bytes(record), 0, static.dtype, points)
