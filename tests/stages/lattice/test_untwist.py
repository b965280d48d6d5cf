"""The motion compensation is found and undone exactly, cold and warm, at any speed."""

import numpy as np
import pytest

from salpcc.stages.lattice.lattice import corrections
from salpcc.stages.lattice.motion_search import is_raw, solve_motion
from salpcc.stages.lattice.near_inverse import near_inverse
from salpcc.stages.lattice.publish import ordered_bits
from salpcc.stages.lattice.untwist import twist, untwist

MOTIONS = {
    "standing": [1e-4, -1e-5, 2e-5, 1e-5, 0.0, 1e-5],
    "city": [-0.8, 0.01, -0.02, 5e-4, 1e-3, -2e-3],
    "motorway": [-3.0, 0.02, 0.03, -1e-3, 2e-3, 5e-3],
    "turning left": [-0.6, 0.05, 0.0, 1e-3, -1e-3, -0.09],
    "turning right": [-0.6, -0.05, 0.0, 1e-3, -1e-3, 0.09],
    "backwards": [0.3, 0.0, 0.0, 0.0, 0.0, 1e-3],
}


@pytest.mark.parametrize("motion", MOTIONS.values(), ids=MOTIONS.keys())
def test_cold_start_finds_the_motion(make_scan, motion) -> None:
    motion = np.array(motion)
    raw = make_scan(motion=None).points.astype(np.float64)
    points = twist(raw, motion).astype(np.float32)
    assert not is_raw(points)
    found = solve_motion(points)
    assert found is not None
    assert np.abs(found - motion).max() < 1e-6
    back, azimuth, ulp, good = untwist(points, found)
    assert good.all()
    assert (back == np.rint(raw * 1000)).all()
    np.testing.assert_allclose(azimuth, np.arctan2(raw[:, 1], raw[:, 0]), atol=1e-12)
    off = ordered_bits(points) - ordered_bits(twist(raw, found).astype(np.float32))
    assert (off == 0).all(axis=1).mean() > 0.98
    assert ((ulp >= 0) == (abs(off) <= 1).all(axis=1)).all()
    assert (corrections(ulp[ulp >= 0].astype(np.uint8)) == off[ulp >= 0]).all()


def test_warm_start_follows_an_acceleration(make_scan) -> None:
    before = np.array(MOTIONS["city"])
    now = before + [-0.03, 0.002, 0.001, 1e-4, 1e-4, 3e-3]
    points = twist(make_scan(motion=None).points.astype(np.float64), now).astype(np.float32)
    found = solve_motion(points, before)
    assert found is not None
    assert np.abs(found - now).max() < 1e-6


def test_a_cloud_without_the_lattice_does_not_lock() -> None:
    cloud = np.random.default_rng(0).normal(0, 10, (5000, 3)).astype(np.float32)
    assert solve_motion(cloud) is None


def test_raw_scans_are_recognised(make_scan) -> None:
    assert is_raw(make_scan(motion=None).points)
    assert not is_raw(make_scan().points)


@pytest.mark.parametrize("motion", MOTIONS.values(), ids=MOTIONS.keys())
def test_near_inverse_is_near_but_for_seam_and_axis(make_scan, motion) -> None:
    raw = make_scan(motion=None).points[::50].astype(np.float64)
    raw = raw[(raw[:, 0] > 0) | (np.abs(raw[:, 1]) > 0.1 * np.abs(raw[:, 0]))]
    raw = raw[np.hypot(raw[:, 0], raw[:, 1]) > 8.0]  # one Newton step is enough there
    assert len(raw) > 200
    points = twist(raw, np.array(motion)).astype(np.float32)
    m = tuple(np.float32(value) for value in motion)
    found = np.array([near_inverse(*point, m) for point in points], np.float64)
    off = np.abs(found - raw).max(axis=1)
    assert np.quantile(off, 0.9) < 5e-5
    assert off.max() < 4e-4  # less than rounds to another millimetre
