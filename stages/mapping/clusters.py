"""Part places into objects: what hangs together, the largest first."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from salpcc.stages.mapping.voxel import keys_of, neighbours_of

F64 = NDArray[np.float64]

CELL = 0.3  # metres; cells that touch, if only at a corner, hang together


def objects_of(xyz: F64) -> NDArray[np.uint32]:
    """Number the objects that places ``(N, 3)`` belong to, ``(N,)`` from 1; 1 is of the most places."""
    if not len(xyz):
        return np.zeros(0, np.uint32)
    cells, cell = np.unique(keys_of(xyz, CELL), return_inverse=True)
    pairs = []
    for shift in neighbours_of():
        at = np.minimum(np.searchsorted(cells, cells + shift), len(cells) - 1)
        touching = np.flatnonzero(cells[at] == cells + shift)
        pairs.append((touching, at[touching]))
    rows, columns = (np.concatenate(side) for side in zip(*pairs, strict=True))
    graph = coo_array((np.ones(len(rows), np.bool_), (rows, columns)), shape=(len(cells),) * 2)
    _, found = connected_components(graph, directed=False)
    label = found[cell.ravel()]
    size = np.bincount(label)
    # Of as many places, the one with the lowest cell first; labels ascend with it.
    order = np.argsort(-size, kind="stable")
    number = np.empty(len(size), np.uint32)
    number[order] = np.arange(1, len(size) + 1)
    return number[label]
