"""The points of a layer: of a movable one among those of the static one, of either in an organised cloud."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from salpcc.stages.lattice.sensor_model import SensorModel
from salpcc.stages.lists.aimed.aimed_layers import Among
from salpcc.stages.lists.learned.learned_lists import LearnedLists
from salpcc.stages.lists.list_coder import AMONG, PLACED, decode_list, encode_list, learned_number
from salpcc.stages.lists.list_plan import plan, snap

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


def bytes_of(data: bytes) -> NDArray[np.uint8]:
    return np.frombuffer(bytearray(data), np.uint8)


def read_back(
    data: bytes, n: int, fan: SensorModel, static: Points | None, max_error: float = 0.0, lists=None
):  # type: ignore[no-untyped-def]
    among = None if static is None else Among.of_list(n, static)
    return decode_list(n, max_error, bytes_of(data), fan, None, lists, among)


@pytest.mark.parametrize("order", ["rows", "rows, returns", "firings", "firings, returns"])
@pytest.mark.parametrize("max_error", [0.0, 0.01])
def test_takes_less_than_alone(fan: SensorModel, rows: Points, order: str, max_error: float) -> None:
    whole, mask = layers_of(rows, order)
    moving, still = snap(whole[mask], max_error, fan), snap(whole[~mask], max_error, fan)
    places = np.flatnonzero(mask)
    alone = encode_list(places, plan(moving, max_error, fan))
    data = encode_list(places, plan(moving, max_error, fan, among=Among.of_list(len(moving), still, mask)))
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
        found = plan(
            moving, 0.0, fan, learned=writer.of_topic("/a"), among=Among.of_list(len(moving), still, mask)
        )
        data = encode_list(np.flatnonzero(mask), found)
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
    data = encode_list(
        np.flatnonzero(mask), plan(moving, max_error, fan, among=Among.of_list(len(moving), still, mask))
    )
    assert data[4] == AMONG
    places, points, _, sound = read_back(data, len(moving), fan, still, max_error)
    assert sound
    assert (places == np.flatnonzero(mask)).all()
    assert points.tobytes() == moving.tobytes()


def test_another_static_layer_is_no_reader(fan: SensorModel, rows: Points) -> None:
    """Without the static layer, or with one of other points, nothing is given back as sound that is not."""
    whole, mask = layers_of(rows, "firings, returns")
    moving, still = whole[mask], whole[~mask]
    data = encode_list(
        np.flatnonzero(mask), plan(moving, 0.0, fan, among=Among.of_list(len(moving), still, mask))
    )
    assert not read_back(data, len(moving), fan, None)[3]
    assert not read_back(data, len(moving), None, still)[3]  # type: ignore[arg-type]
    _, points, _, sound = read_back(data, len(moving), fan, np.ascontiguousarray(still[1:]))
    assert not sound or points.tobytes() != moving.tobytes()


@settings(max_examples=60, deadline=None)
@given(at=st.integers(0, 1 << 30), value=st.integers(0, 255), cut=st.integers(0, 1 << 30))
def test_damage_ends(fan: SensorModel, rows: Points, at: int, value: int, cut: int) -> None:
    whole, mask = layers_of(rows, "firings, returns")
    moving, still = whole[mask], whole[~mask]
    data = bytearray(
        encode_list(
            np.flatnonzero(mask), plan(moving, 0.0, fan, among=Among.of_list(len(moving), still, mask))
        )
    )
    data[at % len(data)] = value
    if cut % 3 == 0:
        data = data[: cut % len(data)]
    places, points, _, _ = read_back(bytes(data), len(moving), fan, still)
    assert len(places) == len(points) == len(moving)


def in_cloud(rows: Points, order: str) -> tuple[Points, NDArray[np.int64], NDArray[np.int64], int]:
    """Points of an organised cloud, the places of those that stay and of those that move, and its width."""
    whole, mask = layers_of(rows, order)
    return whole, np.flatnonzero(~mask), np.flatnonzero(mask), rows.shape[1 if order == "rows" else 0]


@pytest.mark.parametrize("order", ["rows", "firings"])
@pytest.mark.parametrize("max_error", [0.0, 0.01])
def test_layers_of_an_organised_cloud(fan: SensorModel, rows: Points, order: str, max_error: float) -> None:
    """The static layer tells what is gone, and decodes alone; then the movable one tells no places."""
    whole, stays, goes, width = in_cloud(rows, order)
    n = len(whole)
    alone = Among.of_source(n, stays, width)
    still = snap(whole[stays], max_error, fan, among=alone)
    data = encode_list(stays, plan(still, max_error, fan, among=alone))
    assert data[4] == PLACED
    found, points, _, sound = decode_list(
        len(still), max_error, bytes_of(data), fan, among=Among.of_source(n, len(still), 1)
    )
    assert sound
    assert (found == stays).all()
    assert points.tobytes() == still.tobytes()

    moving = snap(whole[goes], max_error, fan)
    told = encode_list(
        goes, plan(moving, max_error, fan, among=Among.of_source(n, goes, width, (stays, still)))
    )
    assert told[4] == PLACED
    found, points, _, sound = decode_list(
        len(moving), max_error, bytes_of(told), fan,
        among=Among.of_source(n, len(moving), 1, (stays, still)),
    )  # fmt: skip
    assert sound
    assert (found == goes).all()
    assert points.tobytes() == moving.tobytes()

    mask = np.isin(np.arange(n), goes)
    listed = encode_list(goes, plan(moving, max_error, fan, among=Among.of_list(len(moving), still, mask)))
    first = encode_list(np.arange(len(still)), plan(still, max_error, fan))
    assert len(data) + len(told) < len(first) + len(listed)


def test_some_of_a_movable_layer_taken_out(fan: SensorModel, rows: Points) -> None:
    whole, stays, goes, width = in_cloud(rows, "rows")
    left = goes[goes % 3 > 0]
    given = stays, whole[stays]
    data = encode_list(
        left, plan(whole[left], 0.0, fan, among=Among.of_source(len(whole), left, width, given))
    )
    assert data[4] == PLACED
    among = Among.of_source(len(whole), len(left), 1, given)
    found, points, _, sound = decode_list(len(left), 0.0, bytes_of(data), fan, among=among)
    assert sound
    assert (found == left).all()
    assert points.tobytes() == whole[left].tobytes()


def test_narrow_rows(fan: SensorModel, rows: Points) -> None:
    """What is not yet known is not looked at, however short rows are."""
    whole, stays, _, _ = in_cloud(rows[:2], "firings")
    data = encode_list(stays, plan(whole[stays], 0.0, fan, among=Among.of_source(len(whole), stays, 2)))
    assert data[4] == PLACED
    among = Among.of_source(len(whole), len(stays), 1)
    found, points, _, sound = decode_list(len(stays), 0.0, bytes_of(data), fan, among=among)
    assert sound
    assert (found == stays).all()
    assert points.tobytes() == whole[stays].tobytes()


@settings(max_examples=60, deadline=None)
@given(at=st.integers(0, 1 << 30), value=st.integers(0, 255), form=st.sampled_from([AMONG, PLACED]))
def test_damage_of_places_ends(fan: SensorModel, rows: Points, at: int, value: int, form: int) -> None:
    whole, stays, _, width = in_cloud(rows, "rows")
    among = Among.of_source(len(whole), stays, width)
    data = bytearray(encode_list(stays, plan(whole[stays], 0.0, fan, among=among)))
    data[4] = form
    data[at % len(data)] = value
    among = Among.of_source(len(whole), len(stays), 1)
    places, points, _, sound = decode_list(len(stays), 0.0, bytes_of(bytes(data)), fan, among=among)
    assert len(places) == len(points) == len(stays)
    assert not sound or data[4] != AMONG
