"""Objects go together: what a network missed of a vehicle stands among what it found.

A small cube above the ground that is movable for the most part is of an object, and what else is in it goes with it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from salpcc.stages.mapping.carve import lies_on_ground
from salpcc.stages.mapping.voxel import Voxels, keys_of

_CUBE = 0.5  # metres
_MOSTLY = 0.7  # share of its points


def rest_of_objects(voxels: Voxels) -> NDArray[np.bool_]:
    """Mark the entries ``(M,)`` that are not called movable but stand in cubes of what is."""
    movable = voxels.movable
    out = np.zeros(len(voxels), np.bool_)
    if not movable.any():
        return out
    above = movable | ~lies_on_ground(voxels)
    _, cube = np.unique(keys_of(voxels.xyz[above], _CUBE), return_inverse=True)
    points = voxels.count[above].astype(np.float64)
    share = np.bincount(cube, points * movable[above]) / np.bincount(cube, points)
    out[above] = (share[cube] >= _MOSTLY) & ~movable[above]
    return out
