"""Fields of organised clouds that hold multiples of a step, or light that is seen without returns: smaller than without, and back to the bit."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from salpcc.schemas.errors import ArchiveError
from salpcc.stages.residual_code.message.field_coder import decode_field, encode_field
from salpcc.stages.residual_code.message.field_modes import FieldModes
from salpcc.stages.residual_code.message.learned_values import LearnedField
from salpcc.stages.residual_code.message.multiples import find_step, holds
from salpcc.stages.residual_code.message.points import SKY, Points
from salpcc.stages.residual_code.message.records import LEARNED, MULTIPLES

ROWS, WIDTH = 16, 256
NAME = ("/a", "ambient")


def picture(seed: int) -> tuple[Points, NDArray[np.int64]]:
    """A wall below a sky without returns, and the light of both, which photons make noisy."""
    rng = np.random.default_rng(seed)
    row, column = np.divmod(np.arange(ROWS * WIDTH), WIDTH)
    turn = 2 * np.pi * column / WIDTH
    far = np.where(row < 7, 0.0, 8.0 + np.sin(turn * 3))
    xyz = np.column_stack([far * np.cos(turn), far * np.sin(turn), 0.1 * far]).astype(np.float32)
    light = np.where(row < 7, 140.0, 60.0) + 20.0 * np.sin(turn * 5)
    return Points.of(xyz, WIDTH), np.rint(light + rng.normal(0, 3, len(row))).astype(np.int64)


def test_steps() -> None:
    for values, step in (
        (np.array([32, 0, 48], np.uint16), 16),
        (np.array([-30, 45], np.int32), 15),
        (np.array([3, 4], np.uint8), 1),
        (np.zeros(3, np.uint8), 1),
        (np.zeros(0, np.uint8), 1),
        (np.array([16.0, 32.0], np.float32), 1),
        (np.concatenate([np.full(5000, 6), [9]]).astype(np.uint32), 3),
        (np.array([1 << 63, 1 << 62], np.uint64), 1 << 62),
    ):
        assert find_step(values) == step


@pytest.mark.parametrize("kind", [np.uint8, np.int16, np.uint16, np.uint32, np.int64])
def test_multiples_take_what_they_are_multiples_of(kind: type) -> None:
    points, light = picture(0)
    values = light.astype(kind)
    step = 1 if kind is np.uint8 else 16
    writer, reader = FieldModes(True), FieldModes()
    once = FieldModes(True).encode(NAME, values, points)
    for seed in range(3):
        points, light = picture(seed)
        values = (light * step).astype(kind)
        record = writer.encode(NAME, values, points)
        assert (record[0] == MULTIPLES) == (step > 1)
        assert record[holds(record)] == LEARNED
        back, end = reader.decode(NAME, record, 0, values.dtype, points)
        assert end == len(record)
        assert back.tobytes() == values.tobytes()
        if seed == 0:
            assert len(record) <= len(once) + 9
    odd = values.copy()
    odd[7] += 1
    record = writer.encode(NAME, odd, points)  # no longer multiples: searched for anew
    assert reader.decode(NAME, record, 0, odd.dtype, points)[0].tobytes() == odd.tobytes()


def test_fast_keeps_its_bytes() -> None:
    points, light = picture(0)
    record = encode_field((16 * light).astype(np.uint16), points)
    assert record[0] != MULTIPLES


def test_light_without_returns_is_a_picture_too() -> None:
    points, light = picture(0)
    record = encode_field(light, points, None, LearnedField())
    assert record[:2] == bytes([LEARNED, SKY])
    values = light.copy()
    values[points.void] = 0
    assert encode_field(values, points, None, LearnedField())[1] != SKY
    few = replace(points, grid=None)
    with pytest.raises(ArchiveError, match="does not decode"):
        decode_field(record, 0, light.dtype, few, None, LearnedField())


def test_what_cannot_be_is_refused() -> None:
    points, light = picture(0)
    values = (16 * light).astype(np.uint16)
    record = encode_field(values, points, None, LearnedField())
    inner = record[holds(record) :]
    for step, kind in ((0, "u2"), (1, "u2"), (1 << 40, "u2"), (16, "f4")):
        data = bytes([MULTIPLES]) + step.to_bytes(8, "little") + inner
        with pytest.raises(ArchiveError, match="does not decode"):
            decode_field(data, 0, np.dtype(kind), points, None, LearnedField())
    for data in (record[:9] + record, record[:5]):
        with pytest.raises(ArchiveError, match="does not decode"):
            decode_field(data, 0, values.dtype, points, None, LearnedField())
