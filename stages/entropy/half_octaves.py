"""How many half octaves a spread is wide: a context of what is coded."""

from __future__ import annotations

import numpy as np
from numba import njit

_HALF_OCTAVE = 1.4142135623730951
_ONE, _FRACTION = 1023 << 52, (1 << 52) - 1  # bits of 1.0, and those below the leading one
_SURELY, _MOST_RATIO = 1e-12, 1e300  # roundings of 64 limits make 1e-14


@njit(cache=True, error_model="numpy", _nrt=False)
def half_octaves(value: float, limit: float, most: int) -> int:
    """Return how many of up to ``most`` limits a value is above, each sqrt(2) times the one before, rounded to float64; ``limit``: the first, not below 0.

    >>> [half_octaves(value, 0.25, 47) for value in (0.25, 0.26, 0.36, 0.5, 1e30)]
    [0, 1, 2, 2, 47]
    """
    ratio = value / limit
    if 1.0 < ratio < _MOST_RATIO:
        # Its exponent tells, and whether its fraction is above sqrt(2); but for what is so near to a limit that only the limit itself does.
        bits = np.float64(ratio).view(np.int64)
        part = np.float64(np.int64((bits & _FRACTION) | _ONE).view(np.float64))
        if min(part - 1.0, 2.0 - part, abs(part - _HALF_OCTAVE)) > _SURELY:
            return min(int(2 * ((bits >> 52) - 1023)) + (2 if part > _HALF_OCTAVE else 1), most)
    found = 0
    while found < most and value > limit:
        limit *= _HALF_OCTAVE
        found += 1
    return found
