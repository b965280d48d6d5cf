"""The plane fit agrees with SciPy's Levenberg-Marquardt on eq. (10)."""

import numpy as np
import pytest
from scipy.optimize import least_squares

from salpcc.stages.ground_fit.plane import fit_plane, plane_distance


@pytest.mark.parametrize("seed", range(5))
def test_against_scipy(seed: int) -> None:
    rng = np.random.default_rng(seed)
    a, b, c = rng.normal(0, 0.2, 3) - [0, 0, 1.7]
    xy = rng.uniform(-20, 20, (200, 2))
    points = np.column_stack([xy, a * xy[:, 0] + b * xy[:, 1] + c + rng.normal(0, 0.05, 200)])
    oracle = least_squares(
        lambda p: plane_distance(points, p), np.zeros(3), method="lm", xtol=1e-14, ftol=1e-14
    )
    assert np.allclose(fit_plane(points), oracle.x, atol=1e-7)


def test_three_points_are_met_exactly_and_fewer_than_a_plane_does_no_harm() -> None:
    corner = np.array([[0.0, 0, 1], [1, 0, 2], [0, 1, 3]])
    assert np.abs(plane_distance(corner, fit_plane(corner))).max() < 1e-9
    line = np.array([[0.0, 0, 1], [1, 1, 1], [2, 2, 1]])
    assert np.isfinite(fit_plane(line)).all()
