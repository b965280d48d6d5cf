"""The order in which the returns of a sweep are coded at effort ``fast``: wave after wave.

A value waits for the one before it in its ring, and for some in the rings above. So rings are coded side by side, each LAG ticks behind
the one above: the returns of a *wave*, at most one a ring, wait for those of earlier waves only.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

LAG = 12  # ticks
_NEVER = 1 << 30


@njit(cache=True, nogil=True)
def waves(starts: NDArray[np.int64], tick: NDArray[np.int32]) -> tuple[NDArray[np.uint8], NDArray[np.int32]]:
    """Return the ring of each return in the order of coding uint8 ``(M,)``, rings without returns not counted, and where each wave ends.

    Args:
        starts: first return of each ring, ``(L + 1,)``.  tick: ``(M,)``.
    """
    first = starts[np.flatnonzero(np.diff(starts))]
    rings, m = len(first), len(tick)
    order, ends = np.empty(m + 1, np.uint8), np.empty(m, np.int32)
    upcoming = np.full(
        rings + 1, 2 * _NEVER, np.int64
    )  # the next tick, of the ring above each, and of the last ring
    for r in range(rings):
        upcoming[r + 1] = tick[first[r]]
    at = np.append(first, m)
    until = np.append(first[1:], m)
    lowest = done = n = 0
    while done < m:
        begin = done
        for r in range(lowest, rings):
            order[done] = r
            done += int(upcoming[r + 1] + LAG <= upcoming[r])
        for k in range(begin, done):
            ring = np.int64(order[k])
            at[ring] += 1
            upcoming[ring + 1] = tick[at[ring]] if at[ring] < until[ring] else _NEVER
        while lowest < rings and upcoming[lowest + 1] == _NEVER:
            lowest += 1
        ends[n] = done
        n += 1
    return order[:m], ends[:n]
