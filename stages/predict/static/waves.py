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
    following = np.full(m, _NEVER, np.int32)  # the tick of the next return of the ring
    following[:-1] = tick[1:]
    following[first[1:] - 1] = _NEVER
    # The next tick, of the ring above each, and of the last ring.
    upcoming = np.full(rings + 1, 2 * _NEVER, np.int64)
    upcoming[1:] = tick[first]
    at = first.copy()
    lowest = done = n = 0
    while done < m:
        begin = done
        above = upcoming[lowest]
        for r in range(lowest, rings):
            own = upcoming[np.uint64(r + 1)]
            order[np.uint64(done)] = r
            done += int(own + LAG <= above)
            above = own
        for k in range(begin, done):
            ring = np.uint64(order[np.uint64(k)])
            upcoming[ring + np.uint64(1)] = following[np.uint64(at[ring])]
            at[ring] += 1
        while lowest < rings and upcoming[lowest + 1] == _NEVER:
            lowest += 1
        ends[n] = done
        n += 1
    return order[:m], ends[:n]
