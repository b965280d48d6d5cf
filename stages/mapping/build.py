"""Build one tile: merge the submaps' entries, take out what moves, fill holes where that is asked."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from salpcc.stages.mapping.carve import contradicted
from salpcc.stages.mapping.config import MapConfig
from salpcc.stages.mapping.fill import fill_ground
from salpcc.stages.mapping.objects import rest_of_objects
from salpcc.stages.mapping.view import View
from salpcc.stages.mapping.voxel import Voxels, fuse

# What speaks against an entry, as bits; one without any is in the map.
CARVED, DROPPED, OBJECT = 1, 2, 4  # seen through; of a movable class; among what is


def build(voxels: Voxels, views: list[View], config: MapConfig) -> tuple[Voxels, NDArray[np.uint8]]:
    """Fuse entries of several submaps in the map's frame; return all, and what speaks against each ``(M,)``.

    What is filled in comes last.
    """
    fused = fuse(voxels, config.voxel)
    against = np.zeros(len(fused), np.uint8)
    if config.carve:
        against[contradicted(fused, views)] |= CARVED
    if not config.keep_movable:
        against[fused.movable] |= DROPPED
        against[rest_of_objects(fused)] |= OBJECT
    if not config.fill:
        return fused, against
    filled = fill_ground(fused[against == 0])
    return Voxels.together([fused, filled]), np.concatenate([against, np.zeros(len(filled), np.uint8)])
