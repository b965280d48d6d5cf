"""Write golden streams of strays whose lasers and times are told (schemas/ARCHIVE.md, 5.4.2 and 5.4.3), of learned ones (5.4.4), of angled ones (5.4.8), and of times of points (5.7).

Only their decoding is for ever the same: what they are fitted by is not the same on every machine.
"""

import json
import zlib
from pathlib import Path

import numpy as np

from salpcc.stages.lattice.aim import aim
from salpcc.stages.lattice.lattice import driven
from salpcc.stages.lattice.list_motion import redo
from salpcc.stages.lattice.sensor_model import load_sensor
from salpcc.stages.lattice.timed_motion import timed_places
from salpcc.stages.lattice.whole_angles import make_points
from salpcc.stages.lists.learned.learned_lists import LearnedLists
from salpcc.stages.lists.list_coder import encode_list
from salpcc.stages.lists.list_plan import plan
from salpcc.stages.residual_code.message.blended_values import encode_blended
from salpcc.stages.residual_code.message.field_modes import FieldModes
from salpcc.stages.residual_code.message.points import Points

TOLD = Path(__file__).parent / "told"
SENSOR = "pandar64"
FIRINGS = 60


def turn(seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points of a turn that a car in motion measured, their lasers, and times in ns; a fifth is missing."""
    sensor, rng = load_sensor(SENSOR), np.random.default_rng(seed)
    laser = np.tile(np.arange(sensor.n_lasers), FIRINGS)
    firing = np.repeat(np.arange(FIRINGS), sensor.n_lasers)
    count = np.rint((9.0 + np.sin(firing / 7) + rng.normal(0, 0.01, len(laser))) / sensor.count)
    still = driven(sensor, laser.astype(np.uint8), (firing * 600).astype(np.int32), count)
    time = firing * 1_666_667
    motion = np.array([0.9, -0.05, 0.01, 0.001, -0.002, 0.01])
    moved = redo(still, timed_places(time, 1.0), motion).astype(np.float32)
    seen = rng.random(len(laser)) < 0.8
    return moved[seen], laser[seen].astype(np.uint8), time[seen]


def standing(seed: int) -> np.ndarray:
    """Points of a turn of a sensor that stands; a tenth is missing."""
    sensor, rng = load_sensor(SENSOR), np.random.default_rng(seed)
    laser = np.tile(np.arange(sensor.n_lasers), FIRINGS)
    firing = np.repeat(np.arange(FIRINGS), sensor.n_lasers)
    count = np.rint((9.0 + np.sin(firing / 7) + rng.normal(0, 0.01, len(laser))) / sensor.count)
    points = driven(sensor, laser.astype(np.uint8), (firing * 600).astype(np.int32), count).astype(np.float32)
    return np.ascontiguousarray(points[rng.random(len(laser)) < 0.9])


def times_of(points: np.ndarray) -> np.ndarray:
    """Seconds as float32 from firings and lasers, with a packet's stamp every ten firings."""
    laser, tick = aim(load_sensor(SENSOR), points.astype(np.float64))[:2]
    firing = (tick + 300) // 600
    stamp = (
        700e-6 * (firing // 10) + np.random.default_rng(7).integers(0, 9, FIRINGS + 1)[firing // 10] / 2**20
    )
    return (stamp + 55.296e-6 * (firing % 10) + 0.8e-6 * laser).astype(np.float32)


def shine_of(points: np.ndarray, often: float = 9.0) -> np.ndarray:
    """Intensities that follow from distances, changing so often, and noise."""
    wall = 60.0 + 40.0 * np.sign(np.sin(often * np.sqrt((points.astype(float) ** 2).sum(axis=1))))
    return np.rint(wall + np.random.default_rng(1).normal(0, 2, len(wall))).astype(np.int64)


def to_and_fro(points: np.ndarray) -> np.ndarray:
    """The same points, every two firings in the place of the next two."""
    size = 2 * load_sensor(SENSOR).n_lasers
    firings = np.arange(len(points)) // size
    return points[np.argsort(firings ^ 1, kind="stable")]


def mirrored() -> np.ndarray:
    """Points on whole angles, each 50th a zero: steps that vary, corrections that change on the way."""
    rng = np.random.default_rng(6)
    block, laser = (of.ravel() for of in np.indices((40, 32)))
    corrected = 256 * ((block + laser) // 30)
    azimuth = np.cumsum(rng.choice([5120, 5122, 4864], 40))[block] + 9000 * (laser % 4) + corrected
    count = np.rint(3000 + 400 * np.sin(block / 7) + rng.normal(0, 3, len(block))).astype(np.int64)
    points = make_points(azimuth, 100_000 - 5130 * laser - corrected, count, 0.004)
    points[::50] = 0
    return np.ascontiguousarray(points[rng.random(len(points)) < 0.8])


def learned(scans: list[np.ndarray], name: str = "learned") -> dict[str, bytes]:
    """Streams and records of the scans of a group, with what was learned of those before."""
    sensor, lists, modes, written = load_sensor(SENSOR), LearnedLists(), FieldModes(True), {}
    for number, points in enumerate(scans):
        found = plan(points, 0.0, sensor, learned=lists.of_topic("/a"))
        written[f"{name}_{number}"] = encode_list(np.arange(len(points)), found)
        lists.settle(1)
        if name != "learned":
            continue
        known = Points.of(points, 0, sensor)
        written[f"values_{number}"] = modes.encode(("/a", "shine"), shine_of(points, 3.0), known)
    return written


def driven_past(turns: list[tuple[np.ndarray, np.ndarray, np.ndarray]]) -> dict[str, bytes]:
    """The same of scans that a car in motion measured, one after the other."""
    sensor, lists, modes, written = load_sensor(SENSOR), LearnedLists(), FieldModes(True), {}
    for number, (points, laser, time) in enumerate(turns):
        time = time + 100_000_000 * number
        found = plan(points, 0.0, sensor, lanes=laser, times=time, learned=lists.of_topic("/a"))
        written[f"passed_{number}"] = encode_list(np.arange(len(points)), found)
        lists.settle(1)
        known = Points.of(points, 0, sensor, found.told)
        written[f"shine_{number}"] = modes.encode(("/a", "shine"), shine_of(points, 3.0), known)
    return written


def on_rays(turns: list[tuple[np.ndarray, np.ndarray, np.ndarray]]) -> dict[str, bytes]:
    """Streams of the same as float16, on rays of no known sensor."""
    lists, written, turning = LearnedLists(), {}, None
    for number, (points, laser, time) in enumerate(turns):
        halves = points.astype(np.float16).astype(np.float32)
        found = plan(halves, 0.0, lanes=laser, times=time, turning=turning, learned=lists.of_topic("/a"))
        written[f"rays_{number}"] = encode_list(np.arange(len(points)), found)
        lists.settle(1)
        turning = found.turning
    return written


def main() -> None:
    points, laser, time = turn()
    sensor = load_sensor(SENSOR)
    halves = points.astype(np.float16).astype(np.float32)
    shine, angled = shine_of(points), mirrored()
    scans = [standing(seed) for seed in (2, 3)]
    turns, times = [turn(seed) for seed in (4, 5)], times_of(scans[0])
    around = Points.of(points, 0, sensor).around(1)
    assert around is not None
    streams = {
        "moved": encode_list(np.arange(len(points)), plan(points, 0.0, sensor, lanes=laser, times=time)),
        "timed": encode_list(np.arange(len(points)), plan(halves, 0.0, lanes=laser, times=time)),
        "blended": encode_blended(shine, around),
        "angled": encode_list(np.arange(len(angled)), plan(angled, 0.0)),
        "times": FieldModes().encode(("/a", "time"), times, Points.of(scans[0], 0, sensor)),
        **learned(scans),
        **learned([to_and_fro(scan) for scan in scans], "shuffled"),
        **driven_past(turns),
        **on_rays(turns),
    }
    expected: dict[str, object] = {
        "n": len(points),
        "moved": [streams["moved"][4], zlib.crc32(points.tobytes())],
        "timed": [streams["timed"][4], zlib.crc32(halves.tobytes())],
        "blended": zlib.crc32(shine.tobytes()),
        "angled": [len(angled), zlib.crc32(angled.tobytes())],
        "times": [streams["times"][0], zlib.crc32(times.tobytes())],
        "learned": [
            [len(scan), zlib.crc32(scan.tobytes()), zlib.crc32(shine_of(scan, 3.0))] for scan in scans
        ],
        "shuffled": [zlib.crc32(to_and_fro(scan).tobytes()) for scan in scans],
        "passed": [
            [len(scan), zlib.crc32(scan.tobytes()), zlib.crc32(shine_of(scan, 3.0))] for scan, _, _ in turns
        ],
        "rays": [
            [len(scan), zlib.crc32(scan.astype(np.float16).astype(np.float32).tobytes())]
            for scan, _, _ in turns
        ],
        "time": zlib.crc32(time.astype("<i8").tobytes()),
    }
    for name, data in streams.items():
        (TOLD / f"{name}.bin").write_bytes(data)
    (TOLD / "expected.json").write_text(json.dumps(expected) + "\n")


if __name__ == "__main__":
    main()
