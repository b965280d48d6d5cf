"""Points on rays as efforts above ``fast`` learn them: to the bit, in fewer bits, and fewer still after a sweep of the same street."""

import numpy as np
import pytest

from salpcc.stages.lattice.list_motion import undo
from salpcc.stages.lists.learned.between import find_between
from salpcc.stages.lists.learned.learned_lists import LearnedLists
from salpcc.stages.lists.list_coder import TIMED, decode_list, encode_list, learned_number
from salpcc.stages.lists.list_plan import plan

LASERS, FIRINGS, CYCLE = 16, 360, 276_000
AHEAD, YAW = 0.5, 0.02  # from sweep to sweep
PLACES = np.array([[1.3, 0.0, 1.7], [1.3, 0.0, 1.6]])
Cloud = tuple[np.ndarray, np.ndarray, np.ndarray]


def street(sweep: int) -> Cloud:
    """What two sensors of a car that drives see between rough walls, as of the middle of the sweep: float16, lasers, times from the sweep's beginning on."""
    rng = np.random.default_rng(abs(sweep))
    elevation = np.radians(np.linspace(-20, 12, LASERS))
    parts = []
    for sensor, place in enumerate(PLACES):
        laser, firing = np.tile(np.arange(LASERS), FIRINGS), np.repeat(np.arange(FIRINGS), LASERS)
        time = 9_700 * sensor + firing * CYCLE + laser // 2 * 2304
        t = time / (FIRINGS * CYCLE) - 0.5
        theta = elevation[(laser * 7) % LASERS] * (1 - 2 * sensor) + 0.001
        phi = -6.3 * t + 0.1 * laser + 1e-3 * np.sin(5 * t) + 1e-4 * rng.normal(size=FIRINGS)[firing]
        ray = np.stack([np.cos(theta) * np.cos(phi), np.cos(theta) * np.sin(phi), np.sin(theta)], axis=1)
        at = np.zeros((len(t), 3))
        at[:, 0] = AHEAD * t
        own, start = turned(ray, YAW * t), turned(np.broadcast_to(place, ray.shape), YAW * t) + at
        # Where that is in the world: the frame of the sweep is the car's in its middle.
        there, began = turned(own, YAW * sweep), turned(start, YAW * sweep) + [AHEAD * sweep, 0.0, 0.0]
        with np.errstate(divide="ignore"):
            sides = np.stack(
                [
                    (np.array([30.0, 5.0, 0.0]) - began) / there,
                    (np.array([-25.0, -7.0, 9.0]) - began) / there,
                ]
            )
        far = np.where(sides > 0, sides, np.inf).min(axis=(0, 2))
        cell = np.floor((began + there * far[:, None]) / 0.6 + 1e-6).astype(np.int64)
        far = (
            far - 0.02 * ((cell @ [73_856_093, 19_349_663, 83_492_791]) % 16) + rng.normal(0, 0.003, len(far))
        )
        parts.append((start + own * far[:, None], laser + LASERS * sensor, time))
    points, laser, time = (np.concatenate(part) for part in zip(*parts, strict=True))
    order = np.argsort(time, kind="stable")
    order = order[rng.random(len(order)) < 0.9]
    return points[order].astype(np.float16).astype(np.float32), laser[order].astype(np.uint8), time[order]


def turned(points: np.ndarray, yaw: np.ndarray | float) -> np.ndarray:
    c, s = np.cos(yaw), np.sin(yaw)
    x, y = points[:, 0], points[:, 1]
    return np.stack([c * x - s * y, s * x + c * y, points[:, 2]], axis=1)


@pytest.fixture(scope="module")
def drive() -> list[Cloud]:
    return [street(sweep) for sweep in range(2)]


def written(drive: list[Cloud], learns: bool = True) -> list[bytes]:
    """Streams of the sweeps of a group, which must decode to them one after the other."""
    writer, reader, streams, turning = LearnedLists(), LearnedLists(), [], None
    for points, laser, time in drive:
        learned = writer.of_topic("/a") if learns else None
        found = plan(points, 0.0, lanes=laser, times=time, turning=turning, learned=learned)
        data = encode_list(np.arange(len(points)), found)
        assert learned_number(data) == int(learns and data[4] == TIMED)
        if learns and data[4] == TIMED:
            writer.settle(1)
        read = np.frombuffer(bytearray(data), np.uint8)
        _, back, told, sound = decode_list(len(points), 0.0, read, lists=reader)
        assert sound
        assert back.tobytes() == points.tobytes()
        if learns and data[4] == TIMED:
            assert told is not None
            assert told.passed is not None
            assert told.passed.number > 0
        turning = found.turning
        streams.append(data)
    return streams


def test_takes_fewer_bits_and_fewer_still_after_a_sweep(drive: list[Cloud]) -> None:
    plain, learned = written(drive, False), written(drive)
    assert {data[4] for data in plain + learned} == {TIMED}
    assert len(learned[0]) < 0.97 * len(plain[0])
    elsewhere = written([street(-20), drive[1]])
    assert len(learned[1]) < 0.985 * len(elsewhere[1])


def test_the_motion_between_sweeps_is_found(drive: list[Cloud]) -> None:
    (before, _, _), (now, laser, _) = drive
    wide = before.astype(np.float64)
    found = find_between(wide, now.astype(np.float64), laser.astype(np.int64), PLACES[0], np.zeros(6))
    assert np.abs(found - [AHEAD, 0, 0, 0, 0, YAW]).max() < 0.02
    moved = undo(wide, np.ones(len(wide)), found)
    assert np.abs(moved - turned(wide - [AHEAD, 0, 0], -YAW)).max(axis=1).mean() < 0.05
    still = find_between(wide, wide, drive[0][1].astype(np.int64), PLACES[0], found)
    assert np.abs(still).max() < 1e-3
    nothing = np.full((2000, 3), np.nan)
    for one, other in ((nothing, wide), (wide, nothing), (wide[:9], wide), (np.zeros((0, 3)), wide)):
        lanes = np.resize(laser, len(other)).astype(np.int64)
        assert not find_between(one, other, lanes, PLACES[0], found).any()


def test_odd_points_come_back(drive: list[Cloud]) -> None:
    points, laser, time = drive[0]
    odd = points.copy()
    odd[::397] += np.float32(1e-4)
    odd[5:900:50] = 0.0
    odd[9:900:50] = -0.0
    odd[11:900:50, 1] = np.inf
    written([(odd, laser, time), drive[1], (odd[:5000], laser[:5000], time[:5000])])


def test_a_trial_that_is_not_settled_leaves_no_trace(drive: list[Cloud]) -> None:
    lists = LearnedLists()
    points, laser, time = drive[0]
    found = plan(points, 0.0, lanes=laser, times=time, learned=lists.of_topic("/a"))
    again = plan(points, 0.0, lanes=laser, times=time, learned=lists.of_topic("/a"))
    assert encode_list(np.arange(len(points)), found) == encode_list(np.arange(len(points)), again)


def test_damaged_streams_end(drive: list[Cloud]) -> None:
    stream, n = written(drive[:1])[0], len(drive[0][0])
    rng = np.random.default_rng(0)
    for _ in range(30):
        data = bytearray(stream[: rng.integers(40, len(stream) + 1)])
        for _ in range(3):
            data[rng.integers(30, len(data))] ^= int(rng.integers(1, 256))
        lists = LearnedLists()
        for read in (data, stream):  # what a damaged one left behind must not stop the next
            back = decode_list(n, 0.0, np.frombuffer(bytearray(read), np.uint8), lists=lists)[1]
            assert back.shape == (n, 3)
    assert not decode_list(n, 0.0, np.frombuffer(bytearray(stream), np.uint8))[3]  # nothing is known
