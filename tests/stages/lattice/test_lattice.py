"""The lattice and its inverse, and the order of points in a file."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from salpcc.stages.lattice.lattice import correction_code, corrections, project, unproject
from salpcc.stages.lattice.order import azimuth_keys, file_order, in_order


def test_project_inverts_unproject_through_the_rounding(sensor) -> None:
    rng = np.random.default_rng(0)
    laser = rng.integers(0, sensor.n_lasers, 20_000)
    tick = rng.integers(0, sensor.ticks_per_turn, 20_000).astype(np.int32)
    count = rng.integers(1_200, 60_000, 20_000).astype(np.int32)
    raw = np.rint(unproject(sensor, laser.astype(np.uint8), tick, count) * 1000).astype(np.int64)
    found_tick, found_count = project(sensor, laser, raw)
    assert (found_tick == tick).all()
    assert (found_count == count).all()


def test_unproject_is_the_formula_of_the_document(sensor) -> None:
    k, tick, count = 40, 1234, 5000
    d = sensor.count * count + sensor.d0[k]
    r = np.sqrt((d * np.cos(sensor.theta[k])) ** 2 - sensor.h[k] ** 2)
    phi = 2 * np.pi * tick / sensor.ticks_per_turn + sensor.phi0[k]
    expected = [
        r * np.cos(phi) - sensor.h[k] * np.sin(phi),
        r * np.sin(phi) + sensor.h[k] * np.cos(phi),
        d * np.sin(sensor.theta[k]) + sensor.z0[k],
    ]
    point = unproject(
        sensor, np.array([k], np.uint8), np.array([tick], np.int32), np.array([count], np.int32)
    )
    assert np.abs(point[0] - expected).max() < 1e-13


@given(st.lists(st.tuples(*[st.integers(-2, 2)] * 3), min_size=1, max_size=20))
def test_correction_code(rows) -> None:
    difference = np.array(rows, np.int64)
    codes = np.array([correction_code(*row) for row in rows])
    inside = (np.abs(difference) <= 1).all(axis=1)
    assert ((codes >= 0) == inside).all()
    assert (corrections(codes[inside].astype(np.uint8)) == difference[inside]).all()


@given(st.lists(st.tuples(st.integers(0, 3), st.integers(0, 30)), max_size=60))
def test_in_order_keeps_a_longest_part_that_sorting_leaves_in_place(rows) -> None:
    rows.sort(key=lambda row: row[0])
    laser = np.array([row[0] for row in rows], np.int64)
    keys = np.array([row[1] for row in rows], np.float64)
    keep = in_order(laser, keys)
    kept_laser, kept_keys = laser[keep], keys[keep]
    assert (np.diff(kept_keys)[np.diff(kept_laser) == 0] > 0).all()
    rising = (np.diff(keys) > 0) | (np.diff(laser) != 0)
    assert keep.all() == rising.all()


def test_file_order_sorts_each_ring_by_azimuth(sensor) -> None:
    rng = np.random.default_rng(1)
    laser = np.sort(rng.integers(0, 3, 300)).astype(np.uint8)
    points = rng.normal(size=(300, 3))
    keys = azimuth_keys(points)
    assert np.allclose(keys, np.arctan2(points[:, 1], points[:, 0]) % (2 * np.pi), atol=1e-14)
    assert (file_order(laser, keys) == np.lexsort((keys, laser))).all()
