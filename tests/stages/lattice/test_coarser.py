"""What is said to be near after coarsening is near, and nearly all that is near is said to be."""

from dataclasses import replace

import numpy as np
import pytest

from salpcc.stages.lattice.coarser import coarser
from salpcc.stages.lattice.publish import points_and_keys
from salpcc.stages.lattice.sweep import scan_to_sweep


@pytest.mark.parametrize("moving", [False, True])
@pytest.mark.parametrize(("step", "max_error"), [(1, 0.001), (7, 0.007), (10, 0.01)])
def test_near_returns_are_near_and_keys_those_of_both(make_scan, sensor, moving, step, max_error) -> None:
    motion = np.array([-2.0, 0.1, 0.1, 1e-3, 1e-3, 0.05]) if moving else None
    sweep = scan_to_sweep(make_scan(motion=motion), sensor)
    assert len(sweep.laser) > 10_000 and (sweep.motion is not None) == moving
    rng = np.random.default_rng(step)
    spoilt = rng.random(len(sweep.laser)) < 0.02
    sweep.millimetre[spoilt] = rng.integers(0, 27, spoilt.sum())
    sweep.ulp[:] = rng.integers(0, 27, len(sweep.ulp))
    coarse = replace(sweep, step=step, max_error=max_error, count=sweep.count // step)
    near, keys, coarse_keys = coarser(sweep, coarse, sensor, max_error)
    source, expected = points_and_keys(sweep, sensor)
    np.testing.assert_array_equal(keys, expected)
    points, expected = points_and_keys(coarse, sensor)
    np.testing.assert_array_equal(coarse_keys, expected)
    distance = np.linalg.norm(points.astype(np.float64) - source.astype(np.float64), axis=1)
    assert (distance[near] <= max_error).all()
    assert (near | spoilt | (distance > max_error)).mean() > 0.95
