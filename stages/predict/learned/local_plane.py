"""Planes through the returns around the next one: weighted least squares over slots, arithmetic as in :mod:`.range_features`.

Slots are the LEFT returns before it on its ring, UPPER of the ring above, SECOND of the one above that: lanes 0 to 23
of a vector of 32; the last eight are none and have weight 0. D is their inverse range less that of the left
neighbour, U their azimuth.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from salpcc.stages.vectors import Lanes, inline, join, lane, load, splice, spread, totals

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
def heights(second: np.float32) -> Lanes:
    """Return V of the slots: 0 on the current ring, 1 on the one above, ``second`` on the next."""
    zero, one, two = spread(_ZERO, 8), spread(_ONE, 8), spread(second, 8)
    return join(join(zero, one), join(splice(one, two, 2), two))


@inline
def fit_plane(
    weight: Lanes, u: Lanes, uu: Lanes, v: Lanes, d: Lanes, ud: Lanes
) -> tuple[np.float32, np.float32, np.float32, np.float32]:
    """Fit ``D = a + b U + c V`` by weighted least squares with a little ridge; ``uu`` and ``ud`` are products. Returns a, b, c, sum of weights."""
    wv = weight * v
    sums = totals(
        weight, weight * u, wv, weight * d, weight * uu, wv * u, wv * v, weight * ud, wv * d
    )  # fmt: skip
    s, su, sv, sd = lane(sums, 0), lane(sums, 1), lane(sums, 2), lane(sums, 3)
    per = _ONE / (s + _TINY)
    mu = su * per
    mv = sv * per
    md = sd * per
    uu_ = lane(sums, 4) - su * mu + _RIDGE_U
    uv = lane(sums, 5) - su * mv
    vv = lane(sums, 6) - sv * mv + _RIDGE_V
    ud_ = lane(sums, 7) - su * md
    vd = lane(sums, 8) - sv * md
    det = _ONE / max(uu_ * vv - uv * uv, _TINY)
    slope_u = (ud_ * vv - vd * uv) * det
    slope_v = (vd * uu_ - ud_ * uv) * det
    return md - slope_u * mu - slope_v * mv, slope_u, slope_v, s


@inline
def weigh(place: Lanes, far: Lanes, off: Lanes, tolerance: np.float32) -> Lanes:
    """Weights of the slots: that of their place over ``far (1 + q^2)^2``, q = off * tolerance."""
    q = off * tolerance
    q = q * q + _ONE
    return place / (far * (q * q))


@inline
def residuals(u: Lanes, v: Lanes, d: Lanes, a: np.float32, b: np.float32, c: np.float32) -> Lanes:
    """Distances of the slots from the plane (a, b, c)."""
    return d - ((v * c + a) + u * b)
