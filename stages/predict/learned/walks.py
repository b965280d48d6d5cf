"""What the walks of ranges and intensities have in common: they predict, decode, or collect rows to train with.

RINGS rings are walked side by side, wave after wave: in a wave, each has its next return, if the rings above are far enough ahead that all that it
is predicted from is known. So the returns of a wave do not wait for each other, and the network takes several at once. More rings at a time leave too
little room in the cache.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from salpcc.stages.entropy.intervals import STATES, begin, ended
from salpcc.stages.entropy.rans import Words
from salpcc.stages.vectors import inline

PREDICT, DECODE, COLLECT = 0, 1, 2
RINGS = 8  # at a time


@inline
def next_wave(is_known, given, top, starts, reached, wave):  # type: ignore[no-untyped-def]
    """Fill ``wave`` with the rings of the next one; return the first ring that has returns left, from ``top`` on, and how many rings.

    Args:
        is_known: of ring k, which has returns left, and ``given``, whether all is known that its next one is predicted from.
        starts: where each ring starts ``(L + 1,)``; reached: how many returns of it are known ``(L,)``.
    """
    n = begun = 0
    while reached[np.uint64(top)] == starts[top + 1] - starts[top]:
        top += 1
    for k in range(top, len(starts) - 1):
        if reached[np.uint64(k)] < starts[k + 1] - starts[k]:
            begun += 1
            if is_known(k, given):
                wave[n] = k
                n += 1
            if begun == RINGS:
                break
    return top, n


class Coded(NamedTuple):
    """Where a walk writes to or reads from.

    Attributes:
        order: ``(M,)`` the laser of each value, in the order of coding.
        intervals: ``(M, 2)`` start and width in the predicted distribution of each value, in that order, where it predicts.
        state, words: of :mod:`salpcc.stages.entropy.intervals`, that it decodes from.
    """

    order: NDArray[np.uint8]
    intervals: NDArray[np.uint32]
    state: NDArray[np.int64]
    words: Words

    @property
    def ended(self) -> bool:
        """Whether all was decoded."""
        return ended(self.state, self.words)


def to_predict(values: int) -> Coded:
    """Make room for the intervals of so many values."""
    return Coded(
        np.zeros(values, np.uint8), np.zeros((values, 2), np.uint32), *_from(np.zeros(2 * STATES, np.uint32))
    )


def to_decode(values: int, data: NDArray[np.uint8]) -> Coded | None:
    """Begin to decode so many values from bytes; None if these cannot be what was encoded."""
    if len(data) % 4 or len(data) < 8 * STATES:
        return None
    words = data.view("<u4").astype(np.uint32)
    if (words[: 2 * STATES : 2] >> 31).any():
        return None
    return Coded(np.zeros(values, np.uint8), np.zeros((0, 2), np.uint32), *_from(words))


def _from(words: Words) -> tuple[NDArray[np.int64], Words]:
    return begin(words), words


class Rows(NamedTuple):
    """Training rows of the returns of which ``place`` ``(M,)`` says one; without any, nothing is collected.

    ``place`` is -1 of others; ``inputs`` are int16 features; ``beside`` what else the network takes of a return; ``target``
    what it should say, of ranges only.
    """

    place: NDArray[np.int64]
    inputs: NDArray[np.int16]
    beside: NDArray[np.float32]
    target: NDArray[np.float32]


NO_ROWS = Rows(
    np.zeros(0, np.int64), np.zeros((0, 0), np.int16), np.zeros((0, 0), np.float32), np.zeros(0, np.float32)
)


def places(keep: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return the row of each return in ``keep`` ``(M,)``, -1 of the others."""
    return np.where(keep, np.cumsum(keep) - 1, -1)
