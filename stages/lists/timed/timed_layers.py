"""Which points of a static layer a walk over those of a movable one heeds: the last ones of the lasers that its points are told from.

A movable point is foretold from points of its laser and of those beside it, a few of each. What is far from all movable points tells nothing but how
the sensor turns, and most points are.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

_LAST = 8  # points of a laser before a movable one


@njit(cache=True)
def heeded_points(
    laser: NDArray[np.uint8], given: NDArray[np.bool_], above: NDArray[np.int64], below: NDArray[np.int64]
) -> NDArray[np.bool_]:
    """Return which points ``(N,)`` a walk goes over: those that are not given, and of those that are the last before one of its laser, or of a laser beside it.

    Args:
        laser, given: of each point ``(N,)``.
        above, below: the lasers beside each; -1: none.
    """
    heeded = np.empty(len(laser), np.bool_)
    wanted = np.zeros(len(above), np.int64)
    for i in range(len(laser) - 1, -1, -1):
        k = laser[i]
        if not given[i]:
            wanted[k] = _LAST
            if above[k] >= 0:
                wanted[above[k]] = _LAST
            if below[k] >= 0:
                wanted[below[k]] = _LAST
        heeded[i] = not given[i] or wanted[k] > 0
        wanted[k] -= given[i]
    return heeded
