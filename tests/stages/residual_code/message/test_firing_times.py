"""Times from lasers and firings: delays are found to the last place, and whatever the times are, they come back."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from salpcc.stages.entropy.number_forms import DECIMAL, from_spans, spans_of
from salpcc.stages.residual_code.message.firing_times import Clocked, Fired, decode_times, encode_times
from salpcc.stages.residual_code.message.fit_delays import find_times

LASERS = 16
I64 = NDArray[np.int64]
NOT_SHIFTED = np.zeros(LASERS + 1, np.int64)


def packets(seed: int, there: float) -> tuple[Fired, NDArray[np.float32]]:
    """Seconds as float32 of points in packets of 24 firings, whose stamps are uneven; half of the firings stand still, upper lasers are rare."""
    rng = np.random.default_rng(seed)
    packet, firing, laser = (of.ravel() for of in np.indices((150, 24, LASERS)))
    stamp = np.cumsum(np.rint(rng.normal(663.6e-6, 1e-6, 150) * 2.0**22)) / 2.0**22
    time = (stamp[packet] + 55.296e-6 * firing + 2.304e-6 * laser).astype(np.float32)
    kept = rng.random(len(time)) < there * (1 - laser / LASERS) ** 2
    tick = 20 * (24 * packet + firing) + (firing % 2) * laser
    return Fired(laser[kept], tick[kept], NOT_SHIFTED, 1 << 17), time[kept]


@pytest.mark.parametrize(("there", "most"), [(1.0, 0.35), (0.3, 1.6)])
def test_rounded_times_of_packets_take_what_the_stamps_do(there: float, most: float) -> None:
    of, values = packets(1, there)
    spans = spans_of(values)
    assert spans is not None
    assert spans.form == DECIMAL
    found = find_times(of, spans.low, spans.high, 4, 1 << 20)
    assert found is not None
    clocked, data = found
    often = np.arange(4)
    delay = clocked.delay[often] - clocked.delay[0]
    assert (np.abs(delay - 2_304_000 * often) < 20).all()
    assert 8 * len(data) < most * len(values)
    numbers, sound = decode_times(of, clocked, data)
    assert sound
    assert (from_spans(numbers, spans.form, spans.power, 0, values.dtype) == values).all()


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 1 << 30),
    n=st.integers(1, 300),
    spread=st.sampled_from([0, 5, 10**6, 1 << 34]),
    slack=st.sampled_from([0, 40]),
    grain=st.integers(0, 16),
    share=st.sampled_from([0.0, 0.3, 0.9, 1.0]),
)
def test_any_times_come_back(seed: int, n: int, spread: int, slack: int, grain: int, share: float) -> None:
    """Of any lasers, none among them, and whatever is known."""
    rng = np.random.default_rng(seed)
    laser = rng.integers(0, LASERS + 1, n)
    of = Fired(laser, rng.integers(0, 500, n), rng.integers(-9, 9, LASERS + 1), 500)
    time = np.cumsum(rng.integers(-spread, spread + 1, n) * (rng.random(n) < 0.3)) + 100 * laser
    low, high, known = time - slack, time + slack, rng.random(n) < share
    clocked = Clocked(grain, np.append(rng.integers(0, 3, LASERS) * 100, 0))
    data = encode_times(of, low, high, clocked, known=known)
    assert data is not None
    given_to_reader = np.where(known, low, -7), np.where(known, high, -7), known
    back, sound = decode_times(of, clocked, data, given_to_reader if known.any() else None)
    assert sound
    assert ((low <= back) & (back <= high))[~known].all()


def test_times_too_far_apart_are_none() -> None:
    of = Fired(np.zeros(3, np.int64), np.zeros(3, np.int64), NOT_SHIFTED, 1)
    for laser in (0, LASERS):
        time = np.array([0, 1, 1 << 45])
        at = Fired(np.full(3, laser), of.tick, of.shift, of.ticks)
        assert encode_times(at, time, time, Clocked(0, NOT_SHIFTED)) is None


@given(st.binary(max_size=200), st.integers(0, 16))
@settings(max_examples=40, deadline=None)
def test_damaged_data_ends(data: bytes, grain: int) -> None:
    of, _ = packets(2, 0.01)
    times, _ = decode_times(of, Clocked(grain, NOT_SHIFTED), data)
    assert len(times) == len(of.laser)
