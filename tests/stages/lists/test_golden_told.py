"""Golden streams of strays whose lasers and times are told, of learned ones, of blended and learned fields: they decode to the same bits for ever.

If a test here fails, the format changed: bump the codec version (schemas/ARCHIVE.md, section 8) and run
``python tests/golden/make_golden_told.py``.
"""

import json
import zlib
from pathlib import Path

import numpy as np
import pytest

from salpcc.stages.lattice.sensor_model import load_sensor
from salpcc.stages.lists.learned.learned_lists import LearnedLists
from salpcc.stages.lists.list_coder import (
    _HEAD,
    ANGLED,
    MOVED,
    TIMED,
    decode_list,
    encode_list,
    learned_number,
)
from salpcc.stages.lists.list_plan import plan
from salpcc.stages.residual_code.message.blended_values import decode_blended, encode_blended
from salpcc.stages.residual_code.message.field_modes import FieldModes
from salpcc.stages.residual_code.message.points import Points
from salpcc.stages.residual_code.message.records import LEARNED, TIMES

TOLD = Path(__file__).parents[2] / "golden" / "told"
EXPECTED = json.loads((TOLD / "expected.json").read_text())
SENSOR = load_sensor("pandar64")


def decoded(name: str) -> np.ndarray:
    data = np.frombuffer(bytearray((TOLD / f"{name}.bin").read_bytes()), np.uint8)
    _, points, told, sound = decode_list(EXPECTED["n"], 0.0, data, SENSOR)
    assert sound
    assert told is not None
    assert zlib.crc32(told.time.astype("<i8").tobytes()) == EXPECTED["time"]
    return points


@pytest.mark.parametrize(("name", "form"), [("moved", MOVED), ("timed", TIMED)])
def test_gives_the_same_points(name: str, form: int) -> None:
    assert EXPECTED[name] == [form, zlib.crc32(decoded(name).tobytes())]


def test_gives_the_same_points_on_whole_angles() -> None:
    n, of_points = EXPECTED["angled"]
    data = (TOLD / "angled.bin").read_bytes()
    assert data[4] == ANGLED
    _, points, _, sound = decode_list(n, 0.0, np.frombuffer(bytearray(data), np.uint8))
    assert sound
    assert zlib.crc32(points.tobytes()) == of_points
    assert encode_list(np.arange(n), plan(points, 0.0)) == data


def test_gives_the_same_values_and_bytes() -> None:
    data = (TOLD / "blended.bin").read_bytes()
    around = Points.of(decoded("moved"), 0, SENSOR).around(1)
    assert around is not None
    values, sound = decode_blended(around, data)
    assert sound
    assert zlib.crc32(values.astype("<i8").tobytes()) == EXPECTED["blended"]
    assert encode_blended(values, around) == data


def test_gives_the_same_points_and_values_of_a_sensor_that_moves() -> None:
    lists, modes = LearnedLists(), FieldModes()
    for number, (n, of_points, of_values) in enumerate(EXPECTED["passed"]):
        data = (TOLD / f"passed_{number}.bin").read_bytes()
        assert [data[4], learned_number(data)] == [MOVED, 1]
        read = np.frombuffer(bytearray(data), np.uint8)
        _, points, told, sound = decode_list(n, 0.0, read, SENSOR, lists=lists)
        assert sound
        assert told is not None
        assert told.passed is not None
        assert (told.passed.there >= 0).any() == (number > 0)
        assert zlib.crc32(points.tobytes()) == of_points
        record = (TOLD / f"shine_{number}.bin").read_bytes()
        assert record[0] == LEARNED
        known = Points.of(points, 0, SENSOR, told)
        values, end = modes.decode(("/a", "shine"), record, 0, np.dtype(np.int64), known)
        assert end == len(record)
        assert zlib.crc32(values) == of_values


def test_gives_the_same_times() -> None:
    data = np.frombuffer(bytearray((TOLD / "learned_0.bin").read_bytes()), np.uint8)
    points = decode_list(EXPECTED["learned"][0][0], 0.0, data, SENSOR, lists=LearnedLists())[1]
    record = (TOLD / "times.bin").read_bytes()
    values, end = FieldModes().decode(
        ("/a", "time"), record, 0, np.dtype(np.float32), Points.of(points, 0, SENSOR)
    )
    assert end == len(record)
    assert EXPECTED["times"] == [TIMES, zlib.crc32(values.tobytes())] == [record[0], EXPECTED["times"][1]]


def test_gives_the_same_points_on_rays_that_are_learned() -> None:
    lists = LearnedLists()
    for number, (n, of_points) in enumerate(EXPECTED["rays"]):
        data = (TOLD / f"rays_{number}.bin").read_bytes()
        assert [data[4], learned_number(data)] == [TIMED, 1]
        read = np.frombuffer(bytearray(data), np.uint8)
        _, points, told, sound = decode_list(n, 0.0, read, lists=lists)
        assert sound
        assert told is not None
        assert told.passed is not None
        assert (told.passed.there >= 0).any() == (number > 0)
        assert zlib.crc32(points.tobytes()) == of_points


def test_gives_the_same_learned_points_and_values_and_bytes() -> None:
    lists, again, modes, modes_again = LearnedLists(), LearnedLists(), FieldModes(), FieldModes(True)
    for number, (n, of_points, of_values) in enumerate(EXPECTED["learned"]):
        data = (TOLD / f"learned_{number}.bin").read_bytes()
        _, points, _, sound = decode_list(
            n, 0.0, np.frombuffer(bytearray(data), np.uint8), SENSOR, lists=lists
        )
        assert sound
        assert learned_number(data) == 1
        assert zlib.crc32(points.tobytes()) == of_points
        assert encode_list(np.arange(n), plan(points, 0.0, SENSOR, learned=again.of_topic("/a"))) == data
        again.settle(1)
        record = (TOLD / f"values_{number}.bin").read_bytes()
        assert record[0] == LEARNED
        known = Points.of(points, 0, SENSOR)
        values, end = modes.decode(("/a", "shine"), record, 0, np.dtype(np.int64), known)
        assert end == len(record)
        assert zlib.crc32(values) == of_values
        assert modes_again.encode(("/a", "shine"), values, known) == record


def test_gives_the_same_points_of_firings_in_a_wrong_order_and_bytes() -> None:
    lists, again = LearnedLists(), LearnedLists()
    for number, ((n, *_), of_points) in enumerate(
        zip(EXPECTED["learned"], EXPECTED["shuffled"], strict=True)
    ):
        data = (TOLD / f"shuffled_{number}.bin").read_bytes()
        _, points, _, sound = decode_list(
            n, 0.0, np.frombuffer(bytearray(data), np.uint8), SENSOR, lists=lists
        )
        assert sound
        body = _HEAD.size + int.from_bytes(data[:4], "little")
        assert [learned_number(data), data[body] & 8] == [1, 8]
        assert zlib.crc32(points.tobytes()) == of_points
        assert encode_list(np.arange(n), plan(points, 0.0, SENSOR, learned=again.of_topic("/a"))) == data
        again.settle(1)
