"""A field keeps the mode that was searched for, as long as that pays, and decodes in any."""

import numpy as np
import pytest
from numpy.typing import NDArray

from salpcc.stages.lattice.sensor_model import load_sensor
from salpcc.stages.residual_code.message import field_modes
from salpcc.stages.residual_code.message.field_coder import decode_field, encode_field
from salpcc.stages.residual_code.message.field_modes import FieldModes
from salpcc.stages.residual_code.message.points import Points

N = 3200
SENSOR = load_sensor("vlp16")


def _points(width: int = 0) -> Points:
    azimuth = np.repeat(np.linspace(0, 6, N // 16), 16)
    elevation = np.tile(np.radians(np.linspace(-15, 15, 16)), N // 16)
    xyz = 20 * np.stack([np.cos(azimuth), np.sin(azimuth), np.tan(elevation)], axis=1)
    return Points.of(xyz.astype(np.float32), width, SENSOR)


def _fields(seed: int) -> dict[str, NDArray[np.generic]]:
    rng = np.random.default_rng(seed)
    firing = np.repeat(np.arange(N // 16), 16)
    return {
        "ring": np.tile(np.arange(16), N // 16).astype(np.uint16),
        "time": (firing * 5e-5 + np.tile(np.arange(16), N // 16) * 2e-6).astype(np.float32),
        "noise": rng.integers(0, 1 << 14, N).astype(np.uint16),
        "walk": rng.integers(-3, 4, N).cumsum().astype(np.int32),
        "grey": (rng.integers(0, 3, N) + 100).astype(np.float32),
    }


@pytest.fixture
def searches(monkeypatch: pytest.MonkeyPatch) -> list[bytes]:
    made: list[bytes] = []

    def counted(*given: object) -> bytes:
        made.append(encode_field(*given))  # type: ignore[arg-type]
        return made[-1]

    monkeypatch.setattr(field_modes, "encode_field", counted)
    return made


@pytest.mark.parametrize("width", [0, 16])
def test_later_scans_take_the_mode_of_the_first(width: int, searches: list[bytes]) -> None:
    modes, points = FieldModes(), _points(width)
    forms: dict[str, int] = {}
    for seed in range(4):
        for name, values in _fields(seed).items():
            coded = modes.encode(("/a", name), values, points)
            assert coded[0] == forms.setdefault(name, coded[0])
            again, end = decode_field(coded, 0, values.dtype, points)
            assert end == len(coded) and again.tobytes() == values.tobytes()
    assert len(searches) == len(forms) == 5


def test_a_field_that_changes_is_searched_for_again(searches: list[bytes]) -> None:
    modes, points = FieldModes(), _points()
    fields = _fields(0)
    turn = np.repeat(
        fields["noise"][: N // 16], 16
    )  # all lasers of a firing the same: nothing to the first mode
    for values in (fields["ring"], fields["ring"], turn, turn, fields["ring"][:16], np.zeros(N, np.uint16)):
        known = points if len(values) == N else Points.of(points.xyz[:16], 0, SENSOR)
        coded = modes.encode(("/a", "kind"), values, known)
        assert decode_field(coded, 0, values.dtype, known)[0].tobytes() == values.tobytes()
        assert len(coded) <= 1.05 * len(encode_field(values, known)) + 0.05 / 8 * len(values)
    assert len(searches) > 2


def test_fields_of_one_name_of_two_topics_do_not_meet(searches: list[bytes]) -> None:
    modes, points, fields = FieldModes(), _points(), _fields(0)
    for _ in range(3):
        modes.encode(("/a", "v"), fields["ring"], points)
        modes.encode(("/b", "v"), fields["time"], points)
    assert len(searches) == 2


def test_a_cloud_without_points_says_nothing_of_those_behind_it(searches: list[bytes]) -> None:
    modes, points = FieldModes(), _points()
    none = Points.of(points.xyz[:0], 0, SENSOR)
    for known in (none, points, none, points):
        for name, values in {**_fields(0), "still": np.zeros(N, np.uint16)}.items():
            few = values[: len(known.xyz)]
            coded = modes.encode(("/a", name), few, known)
            assert decode_field(coded, 0, few.dtype, known)[0].tobytes() == few.tobytes()
    assert len(searches) == 3 * 6  # twice without points, and once with them
