"""The points of a movable layer, told among those of the static one."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from salpcc.stages.lattice.sensor_model import SensorModel
from salpcc.stages.strays.learned.learned_lists import LearnedLists
from salpcc.stages.strays.stray_coder import (
    AMONG,
    Among,
    decode_strays,
    encode_strays,
    learned_number,
    plan,
    snap,
)

Points = NDArray[np.float32]


def things(rows: Points) -> NDArray[np.bool_]:
    """Which points ``(LASERS, COLUMNS)`` are of things that move: three of them, and some by mistake."""
    mask = np.random.default_rng(3).random(rows.shape[:2]) < 0.01
    for row, column in ((8, 40), (14, 200), (10, 400)):
        mask[row : row + 9, column : column + 60] = True
    return mask


def layers_of(rows: Points, order: str) -> tuple[Points, NDArray[np.bool_]]:
    """Points in an order, and which of them move."""
    marked = np.concatenate([rows, things(rows)[..., None]], axis=2)
    flat = (marked if order.startswith("rows") else marked.transpose(1, 0, 2)).reshape(-1, 4)
    if order.endswith("returns"):
        flat = flat[(flat[:, :3] != 0).any(axis=1)]
    return np.ascontiguousarray(flat[:, :3]), flat[:, 3] > 0


def read_back(
    data: bytes, n: int, fan: SensorModel, static: Points | None, max_error: float = 0.0, lists=None
):  # type: ignore[no-untyped-def]
    return decode_strays(n, max_error, np.frombuffer(bytearray(data), np.uint8), fan, None, lists, static)


@pytest.mark.parametrize("order", ["rows", "rows, returns", "firings", "firings, returns"])
@pytest.mark.parametrize("max_error", [0.0, 0.01])
def test_takes_less_than_alone(fan: SensorModel, rows: Points, order: str, max_error: float) -> None:
    whole, mask = layers_of(rows, order)
    moving, still = snap(whole[mask], max_error, fan), snap(whole[~mask], max_error, fan)
    places = np.flatnonzero(mask)
    alone = encode_strays(places, plan(moving, max_error, fan))
    data = encode_strays(places, plan(moving, max_error, fan, among=Among(still, mask)))
    assert data[4] == AMONG
    found, points, told, sound = read_back(data, len(moving), fan, still, max_error)
    assert sound
    assert told is None
    assert (found == places).all()
    assert points.tobytes() == moving.tobytes()
    assert len(data) < 0.8 * len(alone)


def test_learns_from_scan_to_scan(fan: SensorModel, rows: Points) -> None:
    whole, mask = layers_of(rows, "firings, returns")
    moving, still = whole[mask], whole[~mask]
    writer, reader = LearnedLists(), LearnedLists()
    sizes = []
    for _ in range(3):
        found = plan(moving, 0.0, fan, learned=writer.of_topic("/a"), among=Among(still, mask))
        data = encode_strays(np.flatnonzero(mask), found)
        writer.settle(learned_number(data))
        places, points, _, sound = read_back(data, len(moving), fan, still, lists=reader)
        assert sound
        assert points.tobytes() == moving.tobytes()
        assert (places == np.flatnonzero(mask)).all()
        sizes.append(len(data))
    assert sizes[2] < 0.8 * sizes[0]


@pytest.mark.parametrize("max_error", [0.0, 0.01])
def test_odd_points_of_either_layer(fan: SensorModel, rows: Points, max_error: float) -> None:
    """What is on no lattice, or no point at all, keeps its bits and its place in both layers."""
    whole, mask = layers_of(rows, "rows")
    rng = np.random.default_rng(4)
    odd = rng.random(len(whole)) < 0.05
    whole[odd] += rng.normal(0, 0.3, (int(odd.sum()), 3)).astype(np.float32)
    for at in (5, 15 * 512 + 210):
        whole[at : at + 4] = [[np.nan] * 3, [np.inf, 0, 1], [0, 0, 3], [-0.0, 0, 0]]
    assert mask[15 * 512 + 210]
    moving, still = snap(whole[mask], max_error, fan), snap(whole[~mask], max_error, fan)
    data = encode_strays(np.flatnonzero(mask), plan(moving, max_error, fan, among=Among(still, mask)))
    assert data[4] == AMONG
    places, points, _, sound = read_back(data, len(moving), fan, still, max_error)
    assert sound
    assert (places == np.flatnonzero(mask)).all()
    assert points.tobytes() == moving.tobytes()


def test_another_static_layer_is_no_reader(fan: SensorModel, rows: Points) -> None:
    """Without the static layer, or with one of other points, nothing is given back as sound that is not."""
    whole, mask = layers_of(rows, "firings, returns")
    moving, still = whole[mask], whole[~mask]
    data = encode_strays(np.flatnonzero(mask), plan(moving, 0.0, fan, among=Among(still, mask)))
    assert not read_back(data, len(moving), fan, None)[3]
    assert not read_back(data, len(moving), None, still)[3]  # type: ignore[arg-type]
    _, points, _, sound = read_back(data, len(moving), fan, np.ascontiguousarray(still[1:]))
    assert not sound or points.tobytes() != moving.tobytes()


@settings(max_examples=60, deadline=None)
@given(at=st.integers(0, 1 << 30), value=st.integers(0, 255), cut=st.integers(0, 1 << 30))
def test_damage_ends(fan: SensorModel, rows: Points, at: int, value: int, cut: int) -> None:
    whole, mask = layers_of(rows, "firings, returns")
    moving, still = whole[mask], whole[~mask]
    data = bytearray(encode_strays(np.flatnonzero(mask), plan(moving, 0.0, fan, among=Among(still, mask))))
    data[at % len(data)] = value
    if cut % 3 == 0:
        data = data[: cut % len(data)]
    places, points, _, _ = read_back(bytes(data), len(moving), fan, still)
    assert len(places) == len(points) == len(moving)
