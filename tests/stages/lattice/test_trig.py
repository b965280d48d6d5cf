"""Own trigonometry agrees with the C library's to a few units in the last place."""

import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from salpcc.stages.lattice.trig import arctan2, sin_cos, turn_tables

finite = st.floats(-1e3, 1e3, allow_nan=False)


@given(finite, finite)
def test_arctan2(y: float, x: float) -> None:
    if x == 0 and y == 0:
        assert arctan2(y, x) == 0
    else:
        assert abs(arctan2(y, x) - math.atan2(y + 0.0, x + 0.0)) < 1e-15


@given(st.floats(-20, 20))
def test_sin_cos(x: float) -> None:
    sine, cosine = sin_cos(x)
    assert abs(sine - math.sin(x)) < 4e-15
    assert abs(cosine - math.cos(x)) < 4e-15


def test_turn_tables() -> None:
    sines, cosines = turn_tables(4000)
    turn = 2 * np.pi * np.arange(4000) / 4000
    assert np.abs(sines - np.sin(turn)).max() < 1e-15
    assert np.abs(cosines - np.cos(turn)).max() < 1e-15
