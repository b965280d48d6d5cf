"""Planes through the returns around the next one: weighted least squares over slots, arithmetic as in :mod:`.range_features`.

Slots are the LEFT returns before it on its ring, UPPER of the ring above, SECOND of the one above that: lanes 0 to 23
of a vector of 32; the last eight are none and have weight 0. D is their inverse range less that of the left
neighbour, U their azimuth.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from salpcc.stages.predict.vectors import Lanes, inline, join, lane, load, pick, splice, spread

LEFT, UPPER, SECOND = 8, 10, 6
SLOTS = 24
LANES = 32

_RIDGE_U, _RIDGE_V = np.float32(0.02), np.float32(0.005)
_TINY = np.float32(1e-9)
_ZERO, _ONE = np.float32(0.0), np.float32(1.0)

F32 = NDArray[np.float32]


@inline
def slots_around(left: Lanes, upper: F32, u: int, second: F32, s: int) -> Lanes:
    """Gather the slots: eight lanes of the current ring, ten of a row from flat index ``u`` on, six of another from ``s`` on."""
    last = splice(load(upper, u + 8, 8), load(second, s - 2, 8), 2)
    return join(join(left, load(upper, u, 8)), join(last, spread(_ZERO, 8)))


@inline
def _sums(v: Lanes) -> Lanes:
    """Sums over the slots of each ring, in order: lanes 0, 1, 2."""
    s = spread(_ZERO, 4) + pick(v, 0, 8, 18, 31)
    s = s + pick(v, 1, 9, 19, 31)
    s = s + pick(v, 2, 10, 20, 31)
    s = s + pick(v, 3, 11, 21, 31)
    s = s + pick(v, 4, 12, 22, 31)
    s = s + pick(v, 5, 13, 23, 31)
    s = s + pick(v, 6, 14, 31, 31)
    s = s + pick(v, 7, 15, 31, 31)
    s = s + pick(v, 31, 16, 31, 31)
    return s + pick(v, 31, 17, 31, 31)


@inline
def fit_plane(
    weight: Lanes, u: Lanes, uu: Lanes, d: Lanes, ud: Lanes, v: np.float32
) -> tuple[np.float32, np.float32, np.float32, np.float32]:
    """Fit ``D = a + b U + c V`` by weighted least squares with a little ridge; ``uu`` and ``ud`` are products.

    V is 0 on the current ring, 1 on the one above, ``v`` on the next. Returns a, b, c, sum of weights.
    """
    s0, s1, s2 = _sums(weight), _sums(weight * u), _sums(weight * uu)
    s3, s4 = _sums(weight * d), _sums(weight * ud)
    n0v = lane(s0, 2) * v
    s = (lane(s0, 0) + lane(s0, 1)) + lane(s0, 2)
    su = (lane(s1, 0) + lane(s1, 1)) + lane(s1, 2)
    sv = lane(s0, 1) + n0v
    sd = (lane(s3, 0) + lane(s3, 1)) + lane(s3, 2)
    per = _ONE / (s + _TINY)
    mu = su * per
    mv = sv * per
    md = sd * per
    uu_ = (lane(s2, 0) + lane(s2, 1)) + lane(s2, 2) - su * mu + _RIDGE_U
    uv = lane(s1, 1) + lane(s1, 2) * v - su * mv
    vv = lane(s0, 1) + n0v * v - sv * mv + _RIDGE_V
    ud_ = (lane(s4, 0) + lane(s4, 1)) + lane(s4, 2) - su * md
    vd = lane(s3, 1) + lane(s3, 2) * v - sv * md
    det = _ONE / max(uu_ * vv - uv * uv, _TINY)
    slope_u = (ud_ * vv - vd * uv) * det
    slope_v = (vd * uu_ - ud_ * uv) * det
    return md - slope_u * mu - slope_v * mv, slope_u, slope_v, s


@inline
def weigh(place: Lanes, off: Lanes, tolerance: np.float32) -> Lanes:
    """Weights of the slots: that of their place over (1 + q^2)^2, q = off * tolerance."""
    q = off * tolerance
    q = q * q + _ONE
    return place / (q * q)


@inline
def residuals(u: Lanes, d: Lanes, v: np.float32, a: np.float32, b: np.float32, c: np.float32) -> Lanes:
    """Distances of the slots from the plane (a, b, c)."""
    four, two = spread(a, 8), spread(a + c * v, 8)
    upper = spread(a + c, 8)
    level = join(join(four, upper), join(splice(upper, two, 2), two))
    return d - (level + u * b)
