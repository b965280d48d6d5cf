"""Room for what an encoder writes: nobody knows how much before."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray


def run_encoder(encode: Callable[[NDArray[np.uint8]], int], values: int) -> bytes:
    """Call an encoder of about ``values`` values with a buffer, with a larger one if it returns -1.

    >>> def encode(out):
    ...     if len(out) < 5000:
    ...         return -1
    ...     out[:5000] = 7
    ...     return 5000
    >>> len(run_encoder(encode, 10))
    5000
    """
    size = 4 * values + 4096
    while True:
        out = np.empty(size, np.uint8)
        written = encode(out)
        if written >= 0:
            return out[:written].tobytes()
        size *= 4
