"""Points whose lasers and times are told: what turns steadily comes back in few bits, and everything else comes back as well."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from salpcc.stages.entropy.number_forms import spans_of
from salpcc.stages.lists.aimed.aimed_layers import Among
from salpcc.stages.lists.list_coder import TIMED, TIMED_AMONG, decode_list, encode_list
from salpcc.stages.lists.list_plan import plan
from salpcc.stages.lists.timed import timed_points
from salpcc.stages.lists.timed.timed_layers import heeded_points
from salpcc.stages.lists.timeline import Timeline, decode_timeline, encode_timeline, find_timelines
from salpcc.stages.residual_code.message.field_coder import decode_field, encode_field
from salpcc.stages.residual_code.message.points import Points
from salpcc.stages.residual_code.message.records import TIMELINE

LASERS, FIRINGS, CYCLE = 16, 400, 55_296
Listed = tuple[np.ndarray, np.ndarray, np.ndarray]


@pytest.fixture(scope="module")
def merged() -> Listed:
    """A turn of two sensors on a car that drives and turns, moved to one moment, in the order of time: float16, lasers, times in ns."""
    rng = np.random.default_rng(0)
    parts = []
    for sensor, (start, rate, place) in enumerate(
        ((2_000, -6.3, (1.3, 0.1, 1.6)), (9_700, -6.4, (1.3, 0.0, 1.5)))
    ):
        laser, firing = np.tile(np.arange(LASERS), FIRINGS), np.repeat(np.arange(FIRINGS), LASERS)
        time = start + firing * CYCLE + laser // 2 * 2304 - firing // 12 * 40
        t = time / (FIRINGS * CYCLE) - 0.5
        theta = np.radians(np.linspace(-24, 12, LASERS))[(laser * 7) % LASERS] + 0.01 * sensor
        phi = rate * t + 0.1 * laser + 1e-3 * np.sin(5 * t)
        far = np.minimum(14 + 5 * np.sin(3 * phi), 1.6 / np.maximum(-np.sin(theta), 0.02)) + rng.normal(
            0, 0.01, len(t)
        )
        own = far[:, None] * np.stack(
            [np.cos(theta) * np.cos(phi), np.cos(theta) * np.sin(phi), np.sin(theta)], axis=1
        )
        c, s = np.cos(0.02 * t), np.sin(0.02 * t)
        x, y = own[:, 0] + place[0], own[:, 1] + place[1]
        moved = np.stack([c * x - s * y + 1.1 * t, s * x + c * y, own[:, 2] + place[2]], axis=1)
        parts.append((moved, laser + LASERS * sensor, time))
    points, laser, time = (np.concatenate(part) for part in zip(*parts, strict=True))
    order = np.argsort(time, kind="stable")
    order = order[rng.random(len(order)) < 0.8]
    return points[order].astype(np.float16).astype(np.float32), laser[order].astype(np.uint8), time[order]


def coded(points: np.ndarray, laser: np.ndarray, time: np.ndarray) -> tuple[bytes, Timeline | None]:
    data = encode_list(np.arange(len(points)), plan(points, 0.0, lanes=laser, times=time))
    places, back, told, sound = decode_list(len(points), 0.0, np.frombuffer(bytearray(data), np.uint8))
    assert sound
    assert (places == np.arange(len(points))).all()
    assert back.tobytes() == points.tobytes()
    return data, told


def test_fewer_bits_than_rays_that_are_guessed(merged: Listed) -> None:
    points, laser, time = merged
    data, told = coded(points, laser, time)
    assert data[4] == TIMED
    assert told is not None
    assert (told.laser == laser).all()
    assert (told.time == time).all()
    guessed = encode_list(np.arange(len(points)), plan(points, 0.0, lanes=laser))
    assert len(data) < 0.75 * len(guessed)
    assert 8 * len(data) < 14 * len(points)


def test_the_rays_of_the_scan_before_are_a_start_and_no_more(
    merged: Listed, monkeypatch: pytest.MonkeyPatch
) -> None:
    points, laser, time = merged
    first = plan(points, 0.0, lanes=laser, times=time)
    assert first.turning is not None
    cold = timed_points.fit_turning
    monkeypatch.setattr(timed_points, "fit_turning", lambda *_: pytest.fail("sought anew"))
    again = plan(points[40:], 0.0, lanes=laser[40:], times=time[40:], turning=first.turning)
    assert again.coded is not None and again.coded[0] == TIMED
    assert again.turning is not None and again.turning[1] < 1.2 * first.turning[1]
    monkeypatch.setattr(timed_points, "fit_turning", cold)
    other = points[:, [1, 0, 2]]  # turns the other way
    found = plan(other, 0.0, lanes=laser, times=time, turning=first.turning)
    assert encode_list(np.arange(len(other)), found) == coded(other, laser, time)[0]


def test_the_fields_that_are_told_cost_nothing(merged: Listed) -> None:
    points, laser, time = merged
    seconds = 1.6e9 + time / 1e9
    for times in (
        time.astype(np.int32),
        time.astype(np.uint64),
        time / 1e9,
        (time / 1e9).astype(np.float32),
        seconds,
    ):
        spans = spans_of(times)
        assert spans is not None
        _, told = coded(points, laser, spans.low)
        known = Points.of(points, 0, None, told)
        for values in (times, laser.astype(np.uint16)):
            data = encode_field(values, known)
            assert told is None or (data[0] == TIMELINE) == (values is times)
            assert told is None or len(data) < 100
            back, end = decode_field(data, 0, values.dtype, known)
            assert end == len(data)
            assert back.tobytes() == values.tobytes()
        assert told is not None or times.dtype == np.float32  # whose times are too coarse to go on evenly


def test_what_is_odd_comes_back_too(merged: Listed) -> None:
    points, laser, time = merged
    odd = points.copy()
    odd[::97] += np.float32(1e-4)
    odd[5:900:50] = np.nan
    odd[7:900:50] = 0.0
    odd[9:900:50] = -0.0
    odd[11:900:50, 1] = np.inf
    coded(odd, laser, time)
    rng = np.random.default_rng(0)
    coded(points, rng.permutation(laser), time)
    coded(points, laser, rng.permutation(time))
    coded(points, laser, np.zeros_like(time))
    coded(points, np.zeros_like(laser), time * 10**9)
    coded(points, laser, time - 10**15)
    coded(points[:5], laser[:5], time[:5])


@pytest.mark.parametrize("seed", range(6))
def test_any_lasers_at_any_times(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n = 3000
    laser = rng.integers(0, (2, 16, 256)[seed % 3], n).astype(np.uint8)
    time = np.cumsum(rng.integers(-3 if seed > 2 else 0, 50, n)) * (1, 1000)[seed % 2] + rng.integers(0, 9, n)
    _, data = find_timelines(laser, time)[0]
    back, sound = decode_timeline(n, data)
    assert sound
    assert (back.laser == laser).all()
    assert (back.time == time).all()
    assert encode_timeline(back) == data


def test_a_steady_timeline_costs_little(merged: Listed) -> None:
    _, laser, time = merged
    _, data = find_timelines(laser, time)[0]
    assert 8 * len(data) < 1.2 * len(laser)  # a fifth is missing at random: 0.9


@settings(max_examples=40, deadline=None)
@given(st.binary(max_size=200), st.integers(1, 300), st.sampled_from([0, 16]), st.integers(1, 5))
def test_any_bytes_end(data: bytes, n: int, groups: int, cycle: int) -> None:
    """Damage is for the checksum to find; it must neither crash nor hang the decoder."""
    head = b"\x00\x00\x00\x00\x05\x00\x00\x01\x00\x01\x00\x00\x00"
    line = bytes([groups, 1]) + bytes(8) + cycle.to_bytes(4, "little") + data[:100]
    rays = (
        b"\x04\xff\x0f"
        + np.resize(np.frombuffer(data + b"\x01\x00\x00\x00", np.uint8), 4 * (512 + 112 + 6)).tobytes()
    )
    for body in (data, len(line).to_bytes(4, "little") + line + rays + data):
        decode_list(n, 0.0, np.frombuffer(bytearray(head + body), np.uint8))


def layers(merged: Listed) -> tuple[np.ndarray, np.ndarray, Among]:
    """Points of things that move, their places, and the rest."""
    points, laser, time = merged
    mask = (np.arange(len(points)) // 150 % 8 == 3) & (laser % 16 > 4)
    told = laser[~mask], time[~mask], time[mask]
    among = Among.of_list(int(mask.sum()), points[~mask], mask, lambda: told)
    return points[mask], np.flatnonzero(mask), among


def test_a_movable_layer_on_the_rays_of_both(merged: Listed) -> None:
    _, laser, time = merged
    moving, places, among = layers(merged)
    lanes, times = laser[places], time[places]
    data = encode_list(places, plan(moving, 0.0, lanes=lanes, times=times, among=among))
    assert data[4] == TIMED_AMONG
    blank = Among.of_list(len(moving), among.given, timed=among.timed)
    found, back, told, sound = decode_list(
        len(moving), 0.0, np.frombuffer(bytearray(data), np.uint8), among=blank
    )
    assert sound
    assert (found == places).all()
    assert back.tobytes() == moving.tobytes()
    assert told is not None
    assert (told.laser == lanes).all()
    assert (told.time == times).all()
    alone = encode_list(places, plan(moving, 0.0, lanes=lanes, times=times))
    assert len(data) < 0.8 * len(alone)


def test_times_of_given_points_tell_when_the_others_are_due(merged: Listed) -> None:
    _, laser, time = merged
    known = np.ones(len(laser), np.bool_)
    known[1000:9000:40] = False
    line = Timeline(laser, time, LASERS)
    data = encode_timeline(line, given=known)
    assert data is not None
    assert 8 * len(data) < 4 * np.count_nonzero(~known)
    back, sound = decode_timeline(len(laser), data, (known, laser[known], time[known]))
    assert sound
    assert (back.laser == laser).all()
    assert (back.time == time).all()


def test_the_last_points_of_a_laser_and_of_those_beside_it_are_heeded() -> None:
    rng = np.random.default_rng(3)
    laser = rng.integers(0, 6, 3000).astype(np.uint8)
    given = rng.random(3000) < 0.98
    above, below = np.array([-1, 0, 1, -1, 3, 4]), np.array([1, 2, -1, 4, 5, -1])
    expected = ~given
    for i in np.flatnonzero(~given):
        for k in {laser[i], above[laser[i]], below[laser[i]]}:
            before = np.flatnonzero((laser[:i] == k) & given[:i])
            expected[before[-8:]] = True
    assert 0.1 < expected.mean() < 0.9
    assert (heeded_points(laser, given, above, below) == expected).all()


def test_odd_points_beside_a_movable_layer(merged: Listed) -> None:
    points, laser, time = merged
    odd = points.copy()
    odd[5:900:97] = np.nan
    odd[7:900:97, 1] = np.inf
    moving, places, among = layers((odd, laser, time))
    data = encode_list(places, plan(moving, 0.0, lanes=laser[places], among=among))
    blank = Among.of_list(len(moving), among.given, timed=among.timed)
    _, back, _, sound = decode_list(len(moving), 0.0, np.frombuffer(bytearray(data), np.uint8), among=blank)
    assert data[4] == TIMED_AMONG
    assert sound
    assert back.tobytes() == moving.tobytes()


@pytest.fixture(scope="module")
def movable(merged: Listed) -> tuple[np.ndarray, Among, bytes]:
    """Points of things that move, the rest, and what they take."""
    _, laser, _ = merged
    moving, places, among = layers(merged)
    return moving, among, encode_list(places, plan(moving, 0.0, lanes=laser[places], among=among))


@settings(max_examples=20, deadline=None)
@given(at=st.integers(0, 1 << 30), value=st.integers(0, 255), cut=st.integers(0, 1 << 30))
def test_damage_of_a_movable_layer_ends(
    movable: tuple[np.ndarray, Among, bytes], at: int, value: int, cut: int
) -> None:
    moving, among, data = movable
    changed = bytearray(data)
    changed[at % (len(data) if cut % 2 else 100)] = value
    if cut % 3 == 0:
        changed = changed[: cut % len(changed)]
    blank = Among.of_list(len(moving), among.given, timed=among.timed if value else None)
    found, back, _, sound = decode_list(len(moving), 0.0, np.frombuffer(changed, np.uint8), among=blank)
    assert len(found) == len(back) == len(moving)
    assert value or not sound or len(changed) < 5 or changed[4] != TIMED_AMONG
