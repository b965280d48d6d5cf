"""The symbol that a state of the numeral coder holds: how many symbols of its context end at or before its slot.

All ends are compared at once: no search and no branch, and those of a context lie side by side in few lines of a cache, of which a
decoder waits for every one.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from salpcc.stages.entropy.rans import TOTAL, pop, slot_of
from salpcc.stages.vectors import count, inline, load

_TOGETHER = 64

Starts = NDArray[np.uint16]


def starts_of(frequency: NDArray[np.uint16]) -> Starts:
    """Return where the intervals of A symbols begin ``(C, A + 1 or more)``, from 0 to 4096, which fills what is more.

    Raises:
        ValueError: frequencies ``(C, A)`` do not add up to 4096 in every context.
    """
    ends = np.cumsum(frequency, axis=1, dtype=np.int64)
    if not (ends[:, -1] == TOTAL).all():
        raise ValueError("frequencies do not add up")
    symbols = frequency.shape[1]
    compared = -(-(symbols - 1) // _TOGETHER) * _TOGETHER  # the last symbol's end is beyond any slot
    starts = np.full((len(frequency), 1 + max(symbols, compared)), TOTAL, np.uint16)
    starts[:, 0] = 0
    starts[:, 1 : 1 + symbols] = ends
    return starts


@inline
def pop_symbol(x: int, context: int, starts: Starts, blocks: int) -> tuple[int, int]:
    """Return the symbol of a context that the state holds, and the state without it.

    Args:
        blocks: a constant; up to ``64 * blocks + 1`` symbols are told apart.
    """
    slot, first = np.uint16(slot_of(x)), context * starts.shape[1] + 1
    symbol = np.int64(0)
    for block in range(blocks):
        symbol += count(slot >= load(starts, first + block * _TOGETHER, _TOGETHER))
    row, at = np.uint64(context), np.uint64(symbol)
    low = np.int64(starts[row, at])
    return int(symbol), pop(x, low, np.int64(starts[row, at + np.uint64(1)]) - low)
