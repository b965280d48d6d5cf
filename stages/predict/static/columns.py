"""What a walk knows of every ring, in columns: a place a ring, so that rings side by side fill a vector."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from salpcc.stages.vectors import Lanes, choose, inline, load, store

Columns = NDArray[np.float32]  # flat, column after column

LANES = 8
WIDTH = 256 + LANES  # rings that a column has room for, and as many more as vectors may reach beyond
F = np.float32


@inline
def take(columns: Columns, column: int, at: int) -> Lanes:
    """Return the numbers of LANES rings from ring ``at`` on."""
    return load(columns, column * WIDTH + at, LANES)


@inline
def put(columns: Columns, column: int, at: int, numbers: Lanes) -> None:
    """Replace the numbers of LANES rings; inverse of :func:`take`."""
    store(columns, column * WIDTH + at, numbers)


@inline
def renew(columns: Columns, column: int, at: int, active: Lanes, numbers: Lanes) -> None:
    """Replace the numbers of those rings that are ``active``."""
    store(columns, column * WIDTH + at, choose(active, numbers, load(columns, column * WIDTH + at, LANES)))


@inline
def cell(column: int, ring: int | np.int64) -> np.uint64:
    """Return where a ring's number stands in a column."""
    return np.uint64(column * WIDTH + ring)
