"""Half octaves are counted by the bits of a ratio as a loop over all limits counts them, next to every limit, too."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from salpcc.stages.entropy.half_octaves import half_octaves

ANY, POSITIVE = st.floats(), st.floats(0.0)


def counted(value: float, limit: float, most: int) -> int:
    found = 0
    while found < most and value > limit:
        limit *= 1.4142135623730951
        found += 1
    return found


@given(ANY, POSITIVE)
def test_any(value: float, limit: float) -> None:
    assert half_octaves(value, limit, 63) == counted(value, limit, 63)


@given(st.floats(1e-12, 1e12), st.integers(0, 70), st.integers(-3, 3) | st.integers(-20000, 20000))
def test_next_to_limits(limit: float, above: int, ulps: int) -> None:
    value = limit
    for _ in range(above):
        value *= 1.4142135623730951
    value = float((np.float64(value).view(np.int64) + ulps).view(np.float64))
    assert half_octaves(value, limit, 63) == counted(value, limit, 63)
