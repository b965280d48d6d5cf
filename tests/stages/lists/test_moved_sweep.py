"""The sweep before where a moving sensor sees it now: found there, of use to points and to their fields, and never in the way of decoding."""

import numpy as np
import pytest

from salpcc.stages.lattice.aim import aim
from salpcc.stages.lattice.lattice import driven
from salpcc.stages.lattice.list_motion import redo, undo
from salpcc.stages.lattice.sensor_model import SensorModel, load_sensor
from salpcc.stages.lattice.timed_motion import timed_places
from salpcc.stages.lists.aimed.aimed_symbols import AIMED
from salpcc.stages.lists.learned.learned_lists import LearnedLists
from salpcc.stages.lists.learned.moved_sweep import Clock, Passing, seen_later
from salpcc.stages.lists.list_coder import MOVED, decode_list, encode_list
from salpcc.stages.lists.list_plan import plan
from salpcc.stages.residual_code.message.field_modes import FieldModes
from salpcc.stages.residual_code.message.points import Points
from salpcc.stages.residual_code.message.records import LEARNED

FIRINGS, SPAN, SWEEPS = 600, 99_900_000, 3
MOTION = np.array([-1.2, 0.05, 0.0, 0.0, 0.0, 0.0])  # of what stands, as the sensor sees it, in metres a turn
Cloud = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


@pytest.fixture(scope="module")
def sensor() -> SensorModel:
    return load_sensor("pandar64")


def street(sensor: SensorModel, sweep: int) -> Cloud:
    """Points of a turn among boxes on a plain, moved to its end; their rings, times in ns from the first sweep on, and paint. A fifth is missing."""
    rng = np.random.default_rng(7)
    low = np.column_stack(
        [rng.uniform(-40, 40, 60), rng.choice([-1, 1], 60) * rng.uniform(4, 15, 60), np.full(60, -2.0)]
    )
    high = low + rng.uniform(0.5, 4.0, (60, 3))
    rng = np.random.default_rng(sweep)
    laser, firing = (
        np.tile(np.arange(sensor.n_lasers), FIRINGS),
        np.repeat(np.arange(FIRINGS), sensor.n_lasers),
    )
    tick = (firing * (sensor.ticks_per_turn // FIRINGS)).astype(np.int32)
    laser = laser.astype(np.uint8)
    time = firing * (SPAN // (FIRINGS - 1))
    far = np.full(len(laser), 100.0 / sensor.count)
    ray = driven(sensor, laser, tick, far)
    ray /= np.linalg.norm(ray, axis=1)[:, None]
    at = -MOTION[:3] * (sweep + time / SPAN)[:, None]
    with np.errstate(divide="ignore"):
        near, beyond = ((side[None] - at[:, None]) / ray[:, None] for side in (low, high))
    enters, leaves = np.minimum(near, beyond).max(axis=2), np.maximum(near, beyond).min(axis=2)
    hit = np.where((enters < leaves) & (enters > 0.5), enters, np.inf)
    plain = np.where(ray[:, 2] < -0.01, -1.8 / np.minimum(ray[:, 2], -0.01), np.inf)
    distance = np.minimum(hit.min(axis=1), plain)
    paint = np.where(distance < plain, 20 + 3 * hit.argmin(axis=1), 10)
    cell = np.floor((at + ray * np.where(distance < 90.0, distance, 0.0)[:, None]) / 0.5).astype(np.int64)
    rough = (cell @ [73_856_093, 19_349_663, 83_492_791]) % 16  # of the world, not of the sweep
    distance = distance - 0.03 * rough
    seen = (distance < 90.0) & (rng.random(len(laser)) < 0.8)
    distance = (distance + rng.normal(0, 0.004, len(laser)))[seen]
    still = driven(sensor, laser[seen], tick[seen], np.rint(distance / sensor.count))
    points = redo(still, timed_places(time, 1.0)[seen], MOTION).astype(np.float32)
    paint = np.rint(paint[seen] + rng.normal(0, 0.5, int(seen.sum()))).astype(np.int64)
    return points, laser[seen], time[seen] + sweep * SPAN, paint


@pytest.fixture(scope="module")
def drive(sensor: SensorModel) -> list[Cloud]:
    return [street(sensor, sweep) for sweep in range(SWEEPS)]


def sizes(drive: list[Cloud], sensor: SensorModel) -> list[tuple[int, int]]:
    """Bytes of points and of paint of every sweep of a group; all must come back, bit for bit."""
    writer, reader, modes, back = LearnedLists(), LearnedLists(), FieldModes(True), FieldModes()
    found = []
    for points, ring, time, paint in drive:
        planned = plan(points, 0.0, sensor, lanes=ring, times=time, learned=writer.of_topic("/a"))
        data = encode_list(np.arange(len(points)), planned)
        assert data[4] == MOVED
        writer.settle(1)
        read = np.frombuffer(bytearray(data), np.uint8)
        _, again, told, sound = decode_list(len(points), 0.0, read, sensor, lists=reader)
        assert sound
        assert again.tobytes() == points.tobytes()
        record = modes.encode(("/a", "paint"), paint, Points.of(points, 0, sensor, planned.told))
        assert record[0] == LEARNED
        known = Points.of(again, 0, sensor, told)
        assert (back.decode(("/a", "paint"), record, 0, paint.dtype, known)[0] == paint).all()
        found.append((len(data), len(record)))
    return found


def test_what_stands_is_seen_where_it_is_now(sensor: SensorModel, drive: list[Cloud]) -> None:
    passing = []
    for points, _, time, _ in drive[:2]:
        laser, tick, count, _ = aim(sensor, undo(points.astype(np.float64), timed_places(time, 1.0), MOTION))
        kinds = np.full(len(points), AIMED, np.uint8)
        passing.append(Passing(kinds, laser.astype(np.uint8), tick, count, MOTION, Clock.of(time)))
    before, now = passing
    turn = seen_later(before, now, sensor)
    assert sorted(turn.places) == list(range(len(before.laser)))
    phase = sensor.parameters[:, 3] * (sensor.ticks_per_turn / (2 * np.pi))
    close, of = 0, 0
    for k in range(0, sensor.n_lasers, 7):
        first, last = turn.ends[k]
        own = np.flatnonzero(now.laser == k)
        assert (np.diff(turn.azimuth[first : last + 1]) >= 0).all()
        assert turn.links[first, 0] == last
        assert turn.links[last, 1] == first
        for i in own[::5]:
            off = np.abs(turn.azimuth[first : last + 1] - now.tick[i] - phase[k])
            j = first + off.argmin()
            close += abs(turn.inverse[j] * now.count[i] * sensor.count - 1.0) < 0.03
            of += 1
    assert close > 0.7 * of


def test_a_sensor_that_moves_takes_fewer_bits(sensor: SensorModel, drive: list[Cloud]) -> None:
    apart = [(p, ring, time + 3_600_000_000_000 * i, paint) for i, (p, ring, time, paint) in enumerate(drive)]
    anew = [(p, ring, time - time[0], paint) for p, ring, time, paint in drive]
    together, alone = sizes(drive, sensor), sizes(apart, sensor)
    assert together[0] == alone[0]
    assert together[2][0] < 0.97 * alone[2][0]
    assert together[2][1] < 0.98 * alone[2][1]
    assert sizes(anew, sensor)[2][0] < 1.01 * together[2][0]  # times that begin anew with every cloud


def test_a_list_of_another_size_is_not_looked_at(sensor: SensorModel, drive: list[Cloud]) -> None:
    """An archive that was tampered with may tell of places that the scan before has not."""
    writer, modes, records = LearnedLists(), FieldModes(True), []
    for points, ring, time, paint in drive[:2]:
        planned = plan(points, 0.0, sensor, lanes=ring, times=time, learned=writer.of_topic("/a"))
        encode_list(np.arange(len(points)), planned)
        assert planned.told is not None
        writer.settle(1)
        few = slice(None, 900 if not records else None)
        told = planned.told
        if not records:
            told = type(told)(
                told.laser[few],
                told.time[few],
                0,
                told.passed and type(told.passed)(1, told.passed.there[few]),
            )
        known = Points.of(points[few], 0, sensor, told)
        records.append((modes.encode(("/a", "paint"), paint[few], known), known, paint[few]))
    back = FieldModes()
    for record, known, paint in records:
        assert (back.decode(("/a", "paint"), record, 0, paint.dtype, known)[0] == paint).all()
