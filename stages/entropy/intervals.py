"""Values that come with their predicted interval: nothing is left to do but to code it."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.entropy.range_coder import encode_interval, finish_encoder, start_encoder

BITS = 24


@njit(cache=True)
def encode_intervals(intervals: NDArray[np.uint32], out: NDArray[np.uint8]) -> int:
    """Encode starts and widths ``(M, 2)`` of ``2 ** BITS``; return the bytes written to ``out``, -1 if full.

    The decoder has to predict while it decodes: :mod:`salpcc.stages.predict.learned` does both.
    """
    state = start_encoder()
    for i in range(len(intervals)):
        encode_interval(state, out, np.int64(intervals[i, 0]), np.int64(intervals[i, 1]), BITS)
    return finish_encoder(state, out)
