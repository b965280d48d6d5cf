"""Build one tile: merge the submaps' entries, take out what moves, fill holes where that is asked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from salpcc.stages.mapping.carve import contradicted, evidence
from salpcc.stages.mapping.config import MapConfig
from salpcc.stages.mapping.fill import fill_ground
from salpcc.stages.mapping.objects import rest_of_objects
from salpcc.stages.mapping.view import View
from salpcc.stages.mapping.voxel import Voxels, fuse

# What speaks against an entry, as bits; one without any is in the map.
CARVED, DROPPED, OBJECT = 1, 2, 4  # seen through; of a movable class; among what is


@dataclass(frozen=True, eq=False)
class Built:
    """All entries of a tile, and what became of them; what was filled in comes last.

    Attributes:
        against: ``(M,)`` uint8, what speaks against each, as bits.
        through, met: ``(M,)`` uint16, the scans that looked through it, and those whose view ended there.
    """

    voxels: Voxels
    against: NDArray[np.uint8]
    through: NDArray[np.uint16]
    met: NDArray[np.uint16]

    def __getitem__(self, which: NDArray[np.bool_] | NDArray[np.intp]) -> Built:
        """Pick entries."""
        return Built(self.voxels[which], self.against[which], self.through[which], self.met[which])

    @classmethod
    def together(cls, parts: Sequence[Built]) -> Built:
        """Put entries of several one after the other."""
        fates = [
            np.concatenate([np.empty(0, kind), *(getattr(part, name) for part in parts)])
            for name, kind in (("against", np.uint8), ("through", np.uint16), ("met", np.uint16))
        ]
        return cls(Voxels.together([part.voxels for part in parts]), *fates)


def build(voxels: Voxels, views: list[View], config: MapConfig) -> Built:
    """Fuse entries of several submaps in the map's frame, and find what speaks against each."""
    fused = fuse(voxels, config.voxel)
    against = np.zeros(len(fused), np.uint8)
    through, met = evidence(fused.xyz, views if config.carve else [], config.carving)
    against[contradicted(fused, through, met, config.carving)] |= CARVED
    if not config.keep_movable:
        against[fused.movable] |= DROPPED
        against[rest_of_objects(fused)] |= OBJECT
    filled = fill_ground(fused[against == 0]) if config.fill else fused[:0]
    none = np.zeros(len(filled), np.uint16)
    return Built(
        Voxels.together([fused, filled]),
        np.concatenate([against, none.astype(np.uint8)]),
        np.concatenate([through.astype(np.uint16), none]),
        np.concatenate([met.astype(np.uint16), none]),
    )
