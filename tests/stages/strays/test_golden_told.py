"""Golden streams of strays whose lasers and times are told, and of a blended field: they decode to the same bits for ever.

If a test here fails, the format changed: bump the codec version (schemas/ARCHIVE.md, section 8) and run
``python tests/golden/make_golden_told.py``.
"""

import json
import zlib
from pathlib import Path

import numpy as np
import pytest

from salpcc.stages.lattice.sensor_model import load_sensor
from salpcc.stages.residual_code.message.blended_values import decode_blended, encode_blended
from salpcc.stages.residual_code.message.field_coder import Points
from salpcc.stages.strays.stray_coder import MOVED, TIMED, decode_strays

TOLD = Path(__file__).parents[2] / "golden" / "told"
EXPECTED = json.loads((TOLD / "expected.json").read_text())
SENSOR = load_sensor("pandar64")


def decoded(name: str) -> np.ndarray:
    data = np.frombuffer(bytearray((TOLD / f"{name}.bin").read_bytes()), np.uint8)
    _, points, told, sound = decode_strays(EXPECTED["n"], 0.0, data, SENSOR)
    assert sound
    assert told is not None
    assert zlib.crc32(told.time.astype("<i8").tobytes()) == EXPECTED["time"]
    return points


@pytest.mark.parametrize(("name", "form"), [("moved", MOVED), ("timed", TIMED)])
def test_gives_the_same_points(name: str, form: int) -> None:
    assert EXPECTED[name] == [form, zlib.crc32(decoded(name).tobytes())]


def test_gives_the_same_values_and_bytes() -> None:
    data = (TOLD / "blended.bin").read_bytes()
    around = Points.of(decoded("moved"), 0, SENSOR).around(1)
    assert around is not None
    values, sound = decode_blended(around, data)
    assert sound
    assert zlib.crc32(values.astype("<i8").tobytes()) == EXPECTED["blended"]
    assert encode_blended(values, around) == data
