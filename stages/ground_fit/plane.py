"""Fit a plane to ground points by Levenberg-Marquardt (paper, section V-A, eq. (10)).

The plane is ``a x + b y - z + c = 0`` (ground is never vertical); its residual is the distance of a
point along the unit normal ``n``, so the sum of squares is eq. (10).
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

_ROUNDS = 30


@njit(cache=True)
def _cost_and_normal_equations(
    points: NDArray[np.float64], p: NDArray[np.float64]
) -> tuple[float, NDArray[np.float64], NDArray[np.float64]]:
    a, b, c = p[0], p[1], p[2]
    norm2 = a * a + b * b + 1.0
    norm = np.sqrt(norm2)
    h = np.zeros((3, 3))
    g = np.zeros(3)
    j = np.zeros(3)
    cost = 0.0
    for i in range(len(points)):
        height = a * points[i, 0] + b * points[i, 1] + c - points[i, 2]
        r = height / norm
        j[0] = points[i, 0] / norm - height * a / (norm * norm2)
        j[1] = points[i, 1] / norm - height * b / (norm * norm2)
        j[2] = 1.0 / norm
        cost += r * r
        for u in range(3):
            g[u] += j[u] * r
            for v in range(3):
                h[u, v] += j[u] * j[v]
    return cost, h, g


@njit(cache=True, error_model="numpy")
def _solve(h: NDArray[np.float64], g: NDArray[np.float64]) -> NDArray[np.float64]:
    """Solve ``h x = g`` for a positive definite ``(3, 3)`` by elimination; not finite where it is singular.

    LAPACK's answer depends on the machine, and numba takes SciPy's.
    """
    l10, l20 = h[1, 0] / h[0, 0], h[2, 0] / h[0, 0]
    u11, u12 = h[1, 1] - l10 * h[0, 1], h[1, 2] - l10 * h[0, 2]
    l21 = (h[2, 1] - l20 * h[0, 1]) / u11
    y1 = g[1] - l10 * g[0]
    x = np.zeros(3)
    x[2] = (g[2] - l20 * g[0] - l21 * y1) / (h[2, 2] - l20 * h[0, 2] - l21 * u12)
    x[1] = (y1 - u12 * x[2]) / u11
    x[0] = (g[0] - h[0, 1] * x[1] - h[0, 2] * x[2]) / h[0, 0]
    return x


@njit(cache=True)
def fit_plane(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return ``(a, b, c)`` of the plane that minimises eq. (10) over points ``(N, 3)``, N at least 3.

    Levenberg-Marquardt with Marquardt's scaling, from the horizontal plane through the mean.
    """
    p = np.zeros(3)
    p[2] = points[:, 2].mean()
    damping = 1e-3
    cost, h, g = _cost_and_normal_equations(points, p)
    for _ in range(_ROUNDS):
        damped = h.copy()
        for u in range(3):
            damped[u, u] = damped[u, u] * (1.0 + damping) + 1e-12
        step = _solve(damped, g)
        trial = p - step
        trial_cost, trial_h, trial_g = _cost_and_normal_equations(points, trial)
        if trial_cost <= cost:
            done = cost - trial_cost <= 1e-12 * cost
            p, cost, h, g = trial, trial_cost, trial_h, trial_g
            damping *= 0.1
            if done:
                break
        else:
            damping *= 10.0
            if damping > 1e12:
                break
    return p


def plane_distance(points: NDArray[np.float64], plane: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the signed distance ``(N,)`` of points along the unit normal of ``(a, b, c)``."""
    a, b, c = plane
    distance: NDArray[np.float64] = (a * points[:, 0] + b * points[:, 1] + c - points[:, 2]) / np.sqrt(
        a * a + b * b + 1.0
    )
    return distance
