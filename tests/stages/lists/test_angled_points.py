"""Points on whole angles: mirrors and tables of corrections, with points missing, without a return or off the angles."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from salpcc.stages.entropy.integers import encode_column
from salpcc.stages.lattice.whole_angles import TURN, UNITS, find_angles, make_points
from salpcc.stages.lists.angled.angled_points import _BODY, write_angled
from salpcc.stages.lists.list_coder import (
    _HEAD,
    ANGLED,
    along_rays,
    decode_list,
    encode_list,
    off_lattice,
    off_the_lattice,
)
from salpcc.stages.lists.list_plan import plan

LASERS, BLOCKS = 64, 80
F32 = NDArray[np.float32]


def mirrored(seed: int = 0, unit: float = 0.004) -> F32:
    """Points of a face of a mirror: steps that vary, corrections of each laser that change on the way, walls with noise; a third is missing."""
    rng = np.random.default_rng(seed)
    block, laser = (of.ravel() for of in np.indices((BLOCKS, LASERS)))
    clock = 800_000 + np.cumsum(rng.choice([5120, 5122, 4864], BLOCKS))
    corrected = np.cumsum(rng.random((BLOCKS, LASERS)) < 0.02, axis=0)[block, laser] * 256
    azimuth = clock[block] + rng.integers(-80_000, 80_000, LASERS)[laser] + corrected
    elevation = 300_000 - 5_130 * laser + 2 * rng.integers(0, 100, LASERS)[laser] - corrected
    count = np.rint((12 + 3 * np.sin(block / 9) + laser / 40 + rng.normal(0, 0.01, len(laser))) / unit)
    points = make_points(azimuth, elevation, count.astype(np.int64), unit)
    return np.ascontiguousarray(points[rng.random(len(points)) < 0.67])


def back_from(points: F32) -> bytes:
    data = encode_list(np.arange(len(points)), plan(points, 0.0))
    places, back, told, sound = decode_list(len(points), 0.0, np.frombuffer(bytearray(data), np.uint8))
    assert sound
    assert told is None
    assert (places == np.arange(len(points))).all()
    assert back.tobytes() == points.tobytes()
    return data


@pytest.mark.parametrize("unit", UNITS)
def test_points_on_whole_angles_take_what_their_counts_do(unit: float) -> None:
    points = mirrored(1, unit)
    data = back_from(points)
    assert _HEAD.unpack_from(data)[1] == ANGLED
    assert off_lattice(len(points), data) == 0
    assert 8 * len(data) < 17 * len(points)
    assert len(data) < 0.4 * len(along_rays(points, 0.0).on_rays[1])


def test_what_lies_off_the_angles_is_told_as_ever() -> None:
    points = mirrored(2)
    points[::40] = 0
    points[3] = np.nan
    points[5] *= np.float32(1.01)
    points[9, 2] = -points[9, 2]
    data = back_from(points)
    assert _HEAD.unpack_from(data)[1] == ANGLED
    assert off_lattice(len(points), data) == np.count_nonzero(~find_angles(points)[4]) > len(points) // 40  # type: ignore[index]


@pytest.mark.parametrize("seed", range(3))
def test_other_points_are_on_none(seed: int) -> None:
    rng = np.random.default_rng(seed)
    count = rng.integers(500, 20_000, 1000)
    angles = rng.uniform(-1, 1, (2, 1000))
    across = np.cos(angles[0])
    rays = np.column_stack([across * np.cos(angles[1]), across * np.sin(angles[1]), np.sin(angles[0])])
    assert write_angled((rays * count[:, None] * 0.004).astype(np.float32), off_the_lattice(0.0)) is None
    assert write_angled(np.zeros((1000, 3), np.float32), off_the_lattice(0.0)) is None
    assert write_angled(mirrored(seed)[:20], off_the_lattice(0.0)) is None


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 1 << 30))
def test_what_points_were_made_of_is_found(seed: int) -> None:
    rng = np.random.default_rng(seed)
    azimuth, elevation = rng.integers(0, TURN, 500), rng.integers(-TURN // 5, TURN // 5, 500)
    points = make_points(azimuth, elevation, rng.integers(200, 50_000, 500), 0.004)
    found = find_angles(points)
    assert found is not None
    place, *made, same = found
    assert UNITS[place] == 0.004
    assert same.all()
    assert make_points(*made, 0.004).tobytes() == points.tobytes()


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 1 << 30), st.integers(1, 8))
def test_damaged_bodies_are_refused_or_decode(seed: int, many: int) -> None:
    rng = np.random.default_rng(seed)
    points = mirrored(3)[:300]
    points[::40] = 0
    data = bytearray(encode_list(np.arange(len(points)), plan(points, 0.0)))
    assert _HEAD.unpack_from(data)[1] == ANGLED
    for at in rng.integers(_HEAD.size, min(len(data), 120), many):
        data[at] = rng.integers(0, 256)
    whole = decode_list(len(points), 0.0, np.frombuffer(data, np.uint8))
    cut = decode_list(len(points), 0.0, np.frombuffer(data[: len(data) // 2], np.uint8))
    assert len(whole[1]) == len(cut[1]) == len(points)


def test_points_are_off_the_angles_once() -> None:
    points = mirrored(3)[:300]
    data = encode_list(np.arange(len(points)), plan(points, 0.0))
    first, form, *layout = _HEAD.unpack_from(data)
    assert form == ANGLED
    places, gaps = data[_HEAD.size : _HEAD.size + first], encode_column(np.ones(len(points), np.int64))
    body = _BODY.pack(0, 0, len(points), 0, len(gaps), len(data)) + gaps + data
    nested = _HEAD.pack(first, form, *layout) + places + body
    assert not decode_list(len(points), 0.0, np.frombuffer(bytearray(nested), np.uint8))[3]
