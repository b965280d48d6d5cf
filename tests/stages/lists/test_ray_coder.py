"""Points without a lattice: exact or within the bound, in any order, whatever they hold."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from salpcc.stages.entropy.range_coder import start_decoder
from salpcc.stages.lists.list_coder import decode_list, encode_list
from salpcc.stages.lists.list_plan import plan, snap
from salpcc.stages.lists.list_values import decode_values, encode_values
from salpcc.stages.lists.rays.ray_coder import LOOSE, MOVE, NORMAL, code_points, new_models
from salpcc.stages.lists.rays.ray_forms import BITS, FAR, GRID, HALVES
from salpcc.stages.lists.rays.ray_stream import move_points

Points = NDArray[np.float32]


def street(lasers: int, columns: int) -> Points:
    """Ground and a wall, seen by lasers x columns."""
    rng = np.random.default_rng(lasers)
    tilt = np.linspace(0.1, -0.4, lasers)[:, None]
    turn = np.linspace(-np.pi, np.pi, columns, endpoint=False)[None]
    r = np.minimum(1.8 / np.maximum(-np.sin(tilt), 0.02), 15 + 5 * np.sin(3 * turn))
    r = r + rng.normal(0, 0.01, r.shape)
    points = np.stack(
        [r * np.cos(tilt) * np.cos(turn), r * np.cos(tilt) * np.sin(turn), r * np.sin(tilt)], -1
    )
    return points.astype(np.float32)


def round_trip(points: Points, max_error: float) -> tuple[Points, int]:
    places = np.arange(len(points)) * 2
    snapped = snap(points, max_error)
    data = np.frombuffer(bytearray(encode_list(places, plan(snapped, max_error))), np.uint8)
    back, decoded, _, sound = decode_list(len(points), max_error, data)
    assert sound
    assert (back == places).all()
    assert decoded.tobytes() == snapped.tobytes()
    return decoded, len(data)


@pytest.mark.parametrize("max_error", [0.0, 0.01])
@pytest.mark.parametrize("firings", [False, True])
def test_finds_the_lasers(max_error: float, firings: bool) -> None:
    cloud = street(32, 600)
    points = (cloud.transpose(1, 0, 2) if firings else cloud).reshape(-1, 3).copy()
    decoded, size = round_trip(points, max_error)
    if max_error:
        assert not firings or plan(decoded, max_error).layout == (32, 1)
        assert np.linalg.norm(decoded.astype(np.float64) - points, axis=1).max() <= max_error
        assert 8 * size / len(points) < 6.0
    else:
        assert decoded.tobytes() == points.tobytes()
        assert 8 * size / len(points) < 45.0


def test_firings_with_gaps() -> None:
    """Where no distance in the list holds, the lanes are coded."""
    points = street(32, 600).transpose(1, 0, 2).reshape(-1, 3)
    points = points[np.random.default_rng(0).random(len(points)) < 0.7].copy()
    decoded, _ = round_trip(points, 0.0)
    assert decoded.tobytes() == points.tobytes()
    assert plan(points, 0.0).layout == (0, 1)


def test_points_moved_by_chance_still_fit() -> None:
    """Points that no layout reproduces within their bound are coded by their bits."""
    points = np.random.default_rng(0).normal(0, 20, (3000, 3)).astype(np.float32)
    places = np.arange(len(points))
    data = encode_list(places, replace(plan(points, 0.01), layout=(1, 0)))
    assert (
        decode_list(len(points), 0.01, np.frombuffer(bytearray(data), np.uint8))[1].tobytes()
        == points.tobytes()
    )
    assert len(data) < 13 * len(points)


def test_millimetres_are_whole_numbers() -> None:
    points = (np.rint(street(16, 300) * 1000.0) / 1000.0).astype(np.float32).reshape(-1, 3)
    _, size = round_trip(points, 0.0)
    assert 8 * size / len(points) < 12.0


@pytest.mark.parametrize("max_error", [0.0, 0.02])
def test_what_is_no_point_keeps_its_bits(max_error: float) -> None:
    points = street(8, 100).reshape(-1, 3)
    odd = np.array(
        [[np.nan] * 3, [0, 0, 0], [-0.0, 0, 0], [np.inf, 1, 1], [3e38, -3e38, 1e-40], [1e-5, 0, 0]]
    )
    points[10:16] = odd
    points[40:300] = 0
    decoded, size = round_trip(points, max_error)
    with np.errstate(over="ignore"):
        loose = ~(np.abs(points) < 1e6).all(axis=1) | (points.view(np.int32) == 0).all(axis=1)
    assert decoded[loose].tobytes() == points[loose].tobytes()
    assert size < 12 * 800


@settings(max_examples=30)
@given(st.lists(st.tuples(*[st.floats(width=32)] * 3), max_size=40), st.sampled_from([0.0, 0.001, 0.5]))
def test_any_floats(rows: list[tuple[float, float, float]], max_error: float) -> None:
    points = np.array(rows, np.float32).reshape(-1, 3)
    decoded, _ = round_trip(points, max_error)
    finite = np.isfinite(points).all(axis=1)
    off = np.linalg.norm(decoded[finite].astype(np.float64) - points[finite], axis=1)
    assert (off <= max_error).all()


@settings(max_examples=30)
@given(st.binary(max_size=300), st.integers(1, 200))
def test_any_bytes_end(data: bytes, n: int) -> None:
    """Damage is for the checksum to find; it must neither crash nor hang the decoder."""
    decode_list(n, 0.01, np.frombuffer(bytearray(data), np.uint8))
    decode_values(n, np.frombuffer(bytearray(data), np.uint8))


@pytest.mark.parametrize("unit", [1.0, 100.0, 255.0, 3.0])
@pytest.mark.parametrize("layout", [(1, 0), (0, 1), (32, 1)])
def test_values(unit: float, layout: tuple[int, int]) -> None:
    rng = np.random.default_rng(1)
    values = (np.repeat(rng.integers(0, 300, 200), 5) / unit).astype(np.float32)
    values[7] = 0.0
    out = np.empty(8000, np.uint8)
    size = encode_values(values, layout, out)
    decoded, sound = decode_values(len(values), out[:size].copy())
    assert sound
    assert decoded.tobytes() == values.tobytes()


@pytest.mark.parametrize("form", [GRID, BITS, HALVES])
def test_what_a_form_does_not_hold_is_found_without_a_walk(form: int) -> None:
    points = street(8, 100).reshape(-1, 3)
    points[::2] = np.rint(points[::2] * 1000) / 1000 if form == GRID else points[::2].astype(np.float16)
    points[3], points[5, 1], points[7, 0], points[9, 2] = 0.0, np.nan, np.inf, -0.0
    _, kinds, lanes = move_points(points, (8, 1), form, 1000, 0.0, 0.0)
    walked = np.where(kinds == LOOSE, NORMAL, kinds).astype(np.uint8)
    walked[~(np.abs(points) < FAR).all(axis=1)] = LOOSE
    nothing = np.zeros(1, np.uint8)
    code_points(
        MOVE, points.copy(), walked, lanes, 8, 1, form, 1000.0, 0.0, 0.0, new_models(), start_decoder(nothing), nothing
    )  # fmt: skip
    assert (kinds == walked).all()
    assert (kinds == LOOSE).sum() >= (2 if form == BITS else 300)
