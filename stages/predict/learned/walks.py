"""What the walks of ranges and intensities have in common: they predict, decode, or collect rows to train with."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from salpcc.stages.entropy.range_coder import start_decoder

PREDICT, DECODE, COLLECT = 0, 1, 2


class Coded(NamedTuple):
    """Where a walk writes to or reads from.

    Attributes:
        intervals: ``(M, 2)`` start and width in the predicted distribution of each value, where it predicts.
        state, data: of the range coder that it decodes from.
    """

    intervals: NDArray[np.uint32]
    state: NDArray[np.int64]
    data: NDArray[np.uint8]


def to_predict(values: int) -> Coded:
    """Make room for the intervals of so many values."""
    unread = np.zeros(1, np.uint8)
    return Coded(np.zeros((values, 2), np.uint32), start_decoder(unread), unread)


def to_decode(data: NDArray[np.uint8]) -> Coded:
    """Begin to decode bytes."""
    body = np.ascontiguousarray(data)
    return Coded(np.zeros((0, 2), np.uint32), start_decoder(body), body)


class Rows(NamedTuple):
    """Training rows of the returns of which ``keep`` ``(M,)`` is set; without one, nothing is collected.

    ``inputs`` are int16 features; ``beside`` what else the network takes of a return; ``target`` what it should say, of
    ranges only.
    """

    keep: NDArray[np.bool_]
    inputs: NDArray[np.int16]
    beside: NDArray[Any]
    target: NDArray[np.float32]


NO_ROWS = Rows(
    np.zeros(0, np.bool_), np.zeros((0, 0), np.int16), np.zeros((0, 0), np.float32), np.zeros(0, np.float32)
)
