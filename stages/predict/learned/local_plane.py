"""Planes through the returns around the next one: weighted least squares over slots, arithmetic as in :mod:`.features`.

Slots are the LEFT returns before it on its ring, UPPER of the ring above, SECOND of the one above that. D is
their inverse range less that of the left neighbour, U their azimuth, P the weight of their place.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

LEFT, UPPER, SECOND = 8, 10, 6
SLOTS = 24
WORK = 168  # scratch, float32: seven rows of SLOTS, which begin at
U, UU, D, UD, P, W, Q = 0, 24, 48, 72, 96, 120, 144

_RIDGE_U, _RIDGE_V = np.float32(0.02), np.float32(0.005)
_TINY = np.float32(1e-9)
_ZERO, _ONE = np.float32(0.0), np.float32(1.0)

F32 = NDArray[np.float32]


@njit(cache=True, error_model="numpy")
def _sums(work: F32, start: int, n: int) -> tuple[np.float32, np.float32, np.float32, np.float32, np.float32]:
    """Weighted sums of 1, U, U^2, D, U D over the slots of one ring."""
    s0, s1, s2, s3, s4 = _ZERO, _ZERO, _ZERO, _ZERO, _ZERO
    for k in range(start, start + n):
        weight = work[W + k]
        s0 += weight
        s1 += weight * work[U + k]
        s2 += weight * work[UU + k]
        s3 += weight * work[D + k]
        s4 += weight * work[UD + k]
    return s0, s1, s2, s3, s4


@njit(cache=True, error_model="numpy")
def fit_plane(work: F32, v: np.float32) -> tuple[np.float32, np.float32, np.float32, np.float32]:
    """Fit ``D = a + b U + c V`` by least squares with weights W and a little ridge.

    V is 0 on the current ring, 1 on the one above, ``v`` on the next. Returns a, b, c, sum of weights.
    """
    l0, l1, l2, l3, l4 = _sums(work, 0, LEFT)
    m0, m1, m2, m3, m4 = _sums(work, LEFT, UPPER)
    n0, n1, n2, n3, n4 = _sums(work, LEFT + UPPER, SECOND)
    n0v = n0 * v
    s = (l0 + m0) + n0
    su = (l1 + m1) + n1
    sv = m0 + n0v
    sd = (l3 + m3) + n3
    per = _ONE / (s + _TINY)
    mu = su * per
    mv = sv * per
    md = sd * per
    uu = (l2 + m2) + n2 - su * mu + _RIDGE_U
    uv = m1 + n1 * v - su * mv
    vv = m0 + n0v * v - sv * mv + _RIDGE_V
    ud = (l4 + m4) + n4 - su * md
    vd = m3 + n3 * v - sv * md
    det = _ONE / max(uu * vv - uv * uv, _TINY)
    slope_u = (ud * vv - vd * uv) * det
    slope_v = (vd * uu - ud * uv) * det
    return md - slope_u * mu - slope_v * mv, slope_u, slope_v, s


@njit(cache=True, error_model="numpy")
def weigh(work: F32, source: int, centre: np.float32, tolerance: np.float32) -> None:
    """Weights of the slots: position weight over (1 + q^2)^2, q = (source - centre) / tolerance."""
    for k in range(SLOTS):
        q = (work[source + k] - centre) * tolerance
        q = _ONE + q * q
        work[W + k] = work[P + k] / (q * q)


@njit(cache=True, error_model="numpy")
def refit_plane(
    work: F32, v: np.float32, a: np.float32, b: np.float32, c: np.float32, tolerance: np.float32
) -> tuple[np.float32, np.float32, np.float32, np.float32]:
    """Fit the plane again with weights from the distances to the plane (a, b, c)."""
    for k in range(LEFT):
        work[Q + k] = work[D + k] - (a + b * work[U + k])
    for k in range(LEFT, LEFT + UPPER):
        work[Q + k] = work[D + k] - ((a + c) + b * work[U + k])
    for k in range(LEFT + UPPER, SLOTS):
        work[Q + k] = work[D + k] - ((a + c * v) + b * work[U + k])
    weigh(work, Q, _ZERO, tolerance)
    return fit_plane(work, v)
