"""Fields of the two layers of a cloud: times of firings and columns are known from the static layer."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from salpcc.schemas.errors import ArchiveError
from salpcc.stages.lattice.layers import Layered
from salpcc.stages.residual_code.message.field_coder import decode_field, encode_field, encode_like
from salpcc.stages.residual_code.message.firing_times import (
    Clocked,
    Fired,
    decode_times,
    encode_times,
)
from salpcc.stages.residual_code.message.fit_delays import find_times
from salpcc.stages.residual_code.message.learned_values import LearnedField
from salpcc.stages.residual_code.message.points import Points
from salpcc.stages.residual_code.message.ranks import encode_ranks
from salpcc.stages.residual_code.message.records import COLUMNS, LEARNED, MULTIPLES, RANKS

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
    found = find_times(of, low, high, 0, 1 << 20, known)
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
    clocked = Clocked(0, np.append(2304 * np.arange(LASERS), 0))
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


def in_rows(mask: NDArray[np.bool_], width: int = 256) -> tuple[Points, Points]:
    """Points of the static and of the movable layer of an organised cloud, at distances that change smoothly, some without a return."""
    at = np.arange(len(mask))
    ranges = 10 + np.sin(at % width / 20) + at // width * 0.1
    xyz = np.zeros((len(mask), 3), np.float32)
    xyz[:, 0] = np.where(at % 7 == 0, 0, ranges)
    stays, goes = np.flatnonzero(~mask), np.flatnonzero(mask)
    static: Any = SimpleNamespace(source=stays, stray_points=xyz[stays], cloud=None)
    of_static = Points.of(xyz[stays], width, source=(stays, len(mask)))
    return of_static, Points.of(xyz[goes], width, layered=Layered(static, mask), source=(goes, len(mask)))


def test_times_of_columns_in_layers() -> None:
    """Both layers keep the columns; those that the static one has tell the movable ones."""
    time, mask = columns()
    static, movable = in_rows(mask)
    for points, values, beside in ((static, time[~mask], None), (movable, time[mask], time[~mask])):
        record = encode_field(values, points, None, None, beside)
        assert record[0] == COLUMNS
        back, end = decode_field(record, 0, values.dtype, points, None, None, beside)
        assert end == len(record)
        assert (back == values).all()
        assert encode_like(record, values, points, None, None, beside) == record
    assert len(record) < len(encode_field(time[mask], Points.of(movable.xyz, 0))) / 2


@pytest.mark.parametrize("kind", [np.uint16, np.float32])
@pytest.mark.parametrize("learns", [False, True])
def test_pictures_in_layers(kind: type, learns: bool) -> None:
    """Light without a return, steps of 8, and pixels of the other layer as neighbours."""
    _, mask = columns()
    rng = np.random.default_rng(5)
    light = np.cumsum(rng.integers(-1, 2, 256))[None] + np.cumsum(rng.integers(-1, 2, 32))[:, None]
    step = 8 if learns and kind is np.uint16 else 1
    values = (step * (60 + light.ravel() + rng.integers(0, 2, len(mask)))).astype(kind)
    static, movable = in_rows(mask)
    for points, own, beside in ((static, values[~mask], None), (movable, values[mask], values[~mask])):
        writer, reader = LearnedField(), LearnedField()
        sizes = []
        for _ in range(2):  # the second time from what was learned
            record = encode_field(own, points, None, writer if learns else None, beside)
            inner = record[9:] if record[0] == MULTIPLES else record
            assert inner[1] in (2, 5, 6)
            writer.settle(inner[1] if inner[0] == LEARNED else None)
            back, end = decode_field(record, 0, own.dtype, points, None, reader if learns else None, beside)
            assert end == len(record)
            assert back.tobytes() == own.tobytes()
            sizes.append(len(record))
    plain = Points.of(movable.xyz, 0)
    assert sizes[0] < len(encode_field(values[mask], plain, None, LearnedField() if learns else None))


def test_damaged_fields_of_layers_are_refused() -> None:
    time, mask = columns()
    static, _ = in_rows(mask)
    record = bytearray(encode_field(time[~mask], static))
    listed = Points.of(static.xyz, 0)
    with pytest.raises(ArchiveError):
        decode_field(bytes(record), 0, time.dtype, listed)
    record[10:14] = (1 << 31).to_bytes(4, "little")
    with pytest.raises(ArchiveError):
        decode_field(bytes(record), 0, time.dtype, static)
