"""Lists of points as efforts above ``fast`` code them: to the bit, in fewer bits, and fewer still where the sensor stands."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from salpcc.stages.lattice.lattice import unproject
from salpcc.stages.lattice.sensor_model import SensorModel
from salpcc.stages.lists.aimed import aimed_points
from salpcc.stages.lists.learned.learned_lists import MOST_LISTS, LearnedLists
from salpcc.stages.lists.list_coder import AIMED, decode_list, encode_list, learned_number
from salpcc.stages.lists.list_plan import plan, snap

Points = NDArray[np.float32]
LASERS, FIRINGS = 16, 300


@pytest.fixture(scope="module")
def fan() -> SensorModel:
    zero = np.zeros(LASERS)
    theta = np.radians(np.linspace(15, -15, LASERS))
    return SensorModel("fan", 36_000, 0.002, theta, zero, zero, zero, zero, zero.astype(np.int64))


def turn(fan: SensorModel, seed: int, rows: bool = False) -> Points:
    """A room as one turn sees it: walls with noise, some returns missing, firings whose azimuth jitters."""
    rng = np.random.default_rng(seed)
    laser, firing = np.tile(np.arange(LASERS), FIRINGS), np.repeat(np.arange(FIRINGS), LASERS)
    tick = firing * 100 + (0 if rows else rng.integers(0, 2, FIRINGS)[firing])
    wall = 9.0 + 4.0 * np.sin(firing / 15) + np.sign(np.sin(laser * 3.0 + firing / 9))
    count = np.rint((wall + rng.normal(0, 0.008, len(laser))) / fan.count)
    points = unproject(fan, laser.astype(np.uint8), tick.astype(np.int32), count).astype(np.float32)
    if rows:
        return np.ascontiguousarray(points.reshape(FIRINGS, LASERS, 3).transpose(1, 0, 2).reshape(-1, 3))
    return points[rng.random(len(laser)) < 0.85]


def written(scans: list[Points], fan: SensorModel, max_error: float, learns: bool) -> list[bytes]:
    """Streams of the scans of a group, which must decode to them one after the other."""
    writer, reader, streams = LearnedLists(), LearnedLists(), []
    for points in scans:
        snapped = snap(points, max_error, fan)
        learned = writer.of_topic("/a") if learns else None
        data = encode_list(np.arange(len(points)), plan(snapped, max_error, fan, learned=learned))
        assert data[4] == AIMED
        assert learned_number(data) == int(learns)
        if learns:
            writer.settle(1)
        read = np.frombuffer(bytearray(data), np.uint8)
        _, back, _, sound = decode_list(len(points), max_error, read, fan, lists=reader)
        assert sound
        assert back.tobytes() == snapped.tobytes()
        streams.append(data)
    return streams


@pytest.mark.parametrize("max_error", [0.0, 0.01])
def test_takes_fewer_bits_and_learns_from_the_scan_before(fan: SensorModel, max_error: float) -> None:
    scans = [turn(fan, seed) for seed in range(3)]
    plain = [len(data) for data in written(scans, fan, max_error, False)]
    learned = [len(data) for data in written(scans, fan, max_error, True)]
    assert learned[0] < 0.95 * plain[0]
    assert learned[2] < 0.85 * plain[2]


def test_rows_of_an_organised_cloud(fan: SensorModel) -> None:
    scans = [turn(fan, seed, rows=True) for seed in range(2)]
    plain, learned = (written(scans, fan, 0.0, learns) for learns in (False, True))
    assert len(learned[1]) < len(plain[1])


def round_about(fan: SensorModel, seed: int, begin: int, firings: int) -> Points:
    """A room from the tick ``begin`` on, 360 firings in a turn."""
    rng = np.random.default_rng(seed)
    laser, firing = np.tile(np.arange(LASERS), firings), np.repeat(np.arange(firings), LASERS)
    tick = (begin + firing * 100) % fan.ticks_per_turn
    wall = 9.0 + 4.0 * np.sin(tick * (20 * np.pi / fan.ticks_per_turn)) + 0.1 * laser
    count = np.rint((wall + rng.normal(0, 0.008, len(laser))) / fan.count)
    points = unproject(fan, laser.astype(np.uint8), tick.astype(np.int32), count)
    return np.ascontiguousarray(points.astype(np.float32))


def test_after_a_sweep_of_more_than_a_turn(fan: SensorModel) -> None:
    """A scan that begins where the one before has been twice learns from all of it."""
    now = round_about(fan, 1, 600, 350)
    after_a_turn = written([round_about(fan, 0, 0, 360), now], fan, 0.0, True)[1]
    after_more = written([round_about(fan, 0, 0, 370), now], fan, 0.0, True)[1]
    assert len(after_more) < 1.02 * len(after_a_turn)


def form_of(data: bytes) -> int:
    """The byte in which a stream says what its lists go on from."""
    return data[13 + int.from_bytes(data[:4], "little")]


def shuffled(points: Points) -> Points:
    """Firings in the order of a driver that sends packets of three the last one first, and two packets of four late."""
    size = LASERS * 12
    whole = points[: len(points) // size * size].reshape(-1, 4, 3, LASERS, 3)
    return np.ascontiguousarray(whole[:, [2, 3, 0, 1], ::-1].reshape(-1, 3))


def test_lasers_that_go_to_and_fro_are_put_in_order(
    fan: SensorModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    straight = [turn(fan, seed, rows=True) for seed in range(2)]
    straight = [p.reshape(LASERS, FIRINGS, 3).transpose(1, 0, 2).reshape(-1, 3) for p in straight]
    rng = np.random.default_rng(0)
    seen = [rng.random(len(shuffled(p))) < 0.9 for p in straight]
    scans = [shuffled(p)[s] for p, s in zip(straight, seen, strict=True)]
    streams = written(scans, fan, 0.0, True)
    assert [form_of(data) & 8 for data in streams] == [8, 8]
    assert form_of(written([turn(fan, 0)], fan, 0.0, True)[0]) & 8 == 0
    in_order = written([p[: len(s)][s] for p, s in zip(straight, seen, strict=True)], fan, 0.0, True)
    assert [form_of(data) & 8 for data in in_order] == [0, 0]
    monkeypatch.setattr(aimed_points, "is_shuffled", lambda *_: False)
    as_listed = written(scans, fan, 0.0, True)
    assert len(streams[0]) < 0.985 * len(as_listed[0])
    assert len(streams[1]) < 0.95 * len(as_listed[1])
    cut = bytearray(streams[0])
    cut[13 + int.from_bytes(cut[:4], "little")] = 8 + 2  # of nothing that was learned
    assert not decode_list(len(scans[0]), 0.0, np.frombuffer(cut, np.uint8), fan)[3]


def plaster(fan: SensorModel, behind: bool) -> Points:
    """Walls at a few metres, measured with a noise of three counts; ``behind``: a third of the firings see a second wall through them."""
    rng = np.random.default_rng(5)
    laser, firing = np.tile(np.arange(LASERS), 3 * FIRINGS), np.repeat(np.arange(3 * FIRINGS), LASERS)
    wall = 6.0 + 2.0 * np.sin(firing / 90) + 0.02 * laser
    count = np.rint(wall / fan.count + rng.normal(0, 3, len(laser)))
    first = unproject(fan, laser.astype(np.uint8), (firing * 20).astype(np.int32), count)
    far = np.rint(1.5 * wall / fan.count + rng.normal(0, 3, len(laser)))
    second = unproject(fan, laser.astype(np.uint8), (firing * 20).astype(np.int32), far)
    seen = np.ones((len(laser), 2), np.bool_)
    seen[:, 1] = behind & (rng.random(len(laser)) < 1 / 3)
    return np.stack([first, second], axis=1)[seen].astype(np.float32)


@pytest.mark.parametrize("learns", [False, True])
def test_a_wall_costs_its_noise_and_no_more(fan: SensorModel, learns: bool) -> None:
    points = plaster(fan, False)
    noise = np.log2(3 * np.sqrt(2 * np.pi * np.e))  # bits, of the counts
    bits = 8 * len(written([points], fan, 0.0, learns)[0]) / len(points)
    assert bits < noise + (0.5 if learns else 0.65)


@pytest.mark.parametrize("learns", [False, True])
def test_second_returns_leave_the_first_ones_alone(fan: SensorModel, learns: bool) -> None:
    alone, both = plaster(fan, False), plaster(fan, True)
    sizes = [len(written([points], fan, 0.0, learns)[0]) / len(points) for points in (alone, both)]
    assert sizes[1] < (1.7 if learns else 1.9) * sizes[0]


def test_other_points_and_dual_returns_come_back(fan: SensorModel) -> None:
    rng = np.random.default_rng(0)
    scans = []
    for seed in range(3):
        points = np.repeat(turn(fan, seed), 2, axis=0)
        points[1::2] *= rng.choice([1.0, 1.25], (len(points) // 2, 1)).astype(np.float32)
        points[::50] += rng.normal(0, 1, (len(points[::50]), 3)).astype(np.float32)
        points[7:9] = [[np.nan] * 3, [0, 0, 0]]
        scans.append(points[: len(points) - 900 * seed])
    written(scans, fan, 0.0, True)


def test_a_trial_that_is_not_settled_leaves_no_trace(fan: SensorModel) -> None:
    scans = [turn(fan, seed) for seed in range(2)]
    streams = written(scans, fan, 0.0, True)
    lists = LearnedLists()
    for points, data in zip(scans, streams, strict=True):
        found = plan(points, 0.0, fan, learned=lists.of_topic("/a"))
        for _ in range(2):
            assert encode_list(np.arange(len(points)), found) == data
        lists.settle(1)


def test_topics_learn_apart_and_only_so_many(fan: SensorModel) -> None:
    lists = LearnedLists()
    known = [lists.of_topic(f"/{topic}") for topic in range(MOST_LISTS + 1)]
    assert [one and one.number for one in known] == [*range(1, MOST_LISTS + 1), None]
    assert lists.of_topic("/0") is known[0]


def test_damaged_streams_end(fan: SensorModel) -> None:
    points = turn(fan, 0)
    stream = written([points], fan, 0.0, True)[0]
    rng = np.random.default_rng(0)
    for _ in range(60):
        data = bytearray(stream[: rng.integers(40, len(stream) + 1)])
        for _ in range(3):
            data[rng.integers(30, len(data))] ^= int(rng.integers(1, 256))
        back = decode_list(len(points), 0.0, np.frombuffer(data, np.uint8), fan, lists=LearnedLists())[1]
        assert back.shape == points.shape
    read = np.frombuffer(bytearray(stream), np.uint8)
    assert not decode_list(len(points), 0.0, read, fan)[3]  # nothing is known of what was learned
    assert not decode_list(len(points), 0.0, read, replace(fan, theta=fan.theta + 0.1), lists=None)[3]
