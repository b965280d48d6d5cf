"""Searches for the best way to code a field: what they leave out would not have changed what they find."""

import numpy as np
import pytest
from numpy.typing import NDArray

from salpcc.stages.entropy.columns import costs
from salpcc.stages.entropy.symbols import encode_symbols
from salpcc.stages.lists.aimed.aimed_layers import OWN
from salpcc.stages.residual_code.message.blended_values import encode_blended
from salpcc.stages.residual_code.message.column_values import encode_columns, find_shifts
from salpcc.stages.residual_code.message.fit_delays import _agreed
from salpcc.stages.residual_code.message.points import LISTED, Points

I64 = NDArray[np.int64]
RNG = np.random.default_rng(3)


def shifts_one_by_one(values: I64, void: NDArray[np.bool_], width: int) -> list[int]:
    """Every shift of every row tried."""
    column, shifts = np.arange(0, width, max(width // 64, 1)), [0]
    for row in range(1, len(values) // width):
        here, best = row * width + column, -1
        for turn in range(width):
            there = (row - 1) * width + (column + turn) % width
            same = int((~void[here] & ~void[there] & (values[here] == values[there])).sum())
            if same > best:
                best, shift = same, (shifts[-1] + turn) % width
            if same * max(width // 64, 1) > width * 3 // 4:
                break
        shifts.append(shift)
    return shifts


@pytest.mark.parametrize("width, different", [(70, 1), (64, 4), (100, 60), (1000, 9), (1024, 100_000)])
def test_shifts_are_those_of_a_search(width: int, different: int) -> None:
    row = RNG.integers(-different, different, width)
    noise = (RNG.random((5, width)) < 0.4) * RNG.integers(0, different, (5, width))
    values = (np.stack([np.roll(row, 3 * k) for k in range(5)]) + noise).ravel()
    void = RNG.random(len(values)) < 0.2
    role = np.full(len(values), OWN, np.uint8)
    assert find_shifts(values, void, width, role).tolist() == shifts_one_by_one(values, void, width)


@pytest.mark.parametrize("spread", [0, 3, 40_000])
def test_agreed(spread: int) -> None:
    low = RNG.integers(-spread, spread + 1, 200)
    high = low + RNG.integers(0, spread + 1, 200)
    weight = RNG.integers(1, 4, 200)
    held = [int(weight[(low <= value) & (value <= high)].sum()) for value in (*low, *high)]
    least, most, best = _agreed(low, high, weight)
    assert best == max(held)
    for value in (least, most, (least + most) // 2):
        assert weight[(low <= value) & (value <= high)].sum() == best


def test_what_takes_more_bytes_than_another_is_none() -> None:
    values, void = RNG.integers(0, 256, 3000), np.zeros(3000, np.bool_)
    points = Points.of(RNG.normal(0, 9, (3000, 3)).astype(np.float32), 0)
    around = points.around(LISTED)
    assert around is not None
    for encode in (
        lambda to_beat: encode_symbols(values, void, 1, to_beat),
        lambda to_beat: encode_columns(
            values, void, 30, np.zeros(100, np.int64), to_beat, np.full(3000, OWN, np.uint8)
        ),
        lambda to_beat: encode_blended(values, around, None, to_beat),
    ):
        whole = encode(1 << 60)
        assert whole is not None
        assert encode(len(whole)) == whole
        assert encode(len(whole) - 1) is None
        assert encode(100) is None


def test_costs_end_where_all_are_above_what_is_to_be_beaten() -> None:
    values, void = RNG.integers(-1000, 1000, 5000), np.zeros(5000, np.bool_)
    whole = costs(values, void, 16, 32, 1 << 60)
    assert (costs(values, void, 16, 32, int(whole.min())) == whole).all()
    part = costs(values, void, 16, 32, int(whole.min()) // 10)
    assert (part > whole.min() // 10).all()
    assert (part < whole).all()
