"""Close small holes in the ground, where something stood that was taken out, with the plane around them.

A hole is filled only where nothing at all was seen, where ground lies all around it and where that ground is
flat. What is filled in is marked: its class is SYNTHETIC, its number of points and of scans 0.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from salpcc.schemas.labels import GROUND, GROUP_OF_CLASS
from salpcc.stages.ground_fit.plane import fit_plane, plane_distance
from salpcc.stages.mapping.voxel import SYNTHETIC, Voxels

F64 = NDArray[np.float64]

_CELL = 0.25  # metres
_LARGEST = 16.0  # square metres: a lorry's shadow, not an unseen yard
_RIM = 3  # cells around a hole that its plane is fitted to
_MOSTLY = 0.8  # share of the cells next to a hole that must be ground
_FLAT = 0.05  # metres, root mean square of the rim's distance to its plane
_STEEP = 0.3  # rise per metre, above which it is no ground

_IS_GROUND = np.zeros(256, np.bool_)
_IS_GROUND[: len(GROUP_OF_CLASS)] = GROUP_OF_CLASS == GROUND


def fill_ground(voxels: Voxels) -> Voxels:
    """Return what closes the holes in a tile's ground, one entry per 0.25 m; no entries where there is none.

    A hole that reaches the edge of what was seen is left open: how large it is nobody knows.
    """
    ground = _IS_GROUND[voxels.classes]
    if np.count_nonzero(ground) < 3:
        return voxels[:0]
    low = np.floor(voxels.xyz[:, :2].min(axis=0) / _CELL).astype(np.int64) - 1
    at = np.floor(voxels.xyz[:, :2] / _CELL).astype(np.int64) - low
    shape = tuple(at.max(axis=0) + 2)
    seen = np.zeros(shape, np.bool_)
    seen[at[:, 0], at[:, 1]] = True
    is_ground = np.zeros(shape, np.bool_)
    is_ground[at[ground, 0], at[ground, 1]] = True
    labels, _ = ndimage.label(~seen)
    cells = np.bincount(labels.ravel())
    outside = set(np.unique(np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]])))
    places = at[ground]
    parts = []
    for number, box in enumerate(ndimage.find_objects(labels), start=1):
        if box is None or number in outside or cells[number] * _CELL**2 > _LARGEST:
            continue
        x0, x1 = box[0].start - _RIM, box[0].stop + _RIM
        y0, y1 = box[1].start - _RIM, box[1].stop + _RIM
        window = (slice(max(x0, 0), x1), slice(max(y0, 0), y1))
        hole = labels[window] == number
        edge = ndimage.binary_dilation(hole, np.ones((3, 3), np.bool_)) & ~hole
        if is_ground[window][edge].mean() < _MOSTLY:
            continue
        rim = ndimage.binary_dilation(hole, np.ones((3, 3), np.bool_), _RIM) & is_ground[window]
        near = (places[:, 0] >= window[0].start) & (places[:, 0] < x1)
        near &= (places[:, 1] >= window[1].start) & (places[:, 1] < y1)
        inside = np.flatnonzero(near)
        on_rim = inside[rim[places[inside, 0] - window[0].start, places[inside, 1] - window[1].start]]
        entries = np.flatnonzero(ground)[on_rim]
        parts += _closed(
            voxels, entries, (np.argwhere(hole) + [window[0].start, window[1].start] + low + 0.5) * _CELL
        )
    return Voxels.together(parts)


def _closed(voxels: Voxels, rim: NDArray[np.intp], holes: F64) -> list[Voxels]:
    """Lay a plane through the rim's entries over the hole's places ``(K, 2)``; nothing where it is not flat."""
    points = voxels.xyz[rim]
    if len(points) < 6:
        return []
    middle = points.mean(axis=0)
    plane = fit_plane(points - middle)
    off = plane_distance(points - middle, plane)
    if np.sqrt(np.mean(off**2)) > _FLAT or np.hypot(plane[0], plane[1]) > _STEEP:
        return []
    local = holes - middle[:2]
    z = local @ plane[:2] + plane[2] + middle[2]
    n = len(holes)
    return [
        Voxels(
            np.column_stack([holes, z]),
            np.full(n, voxels.intensity[rim].mean(), np.float32),
            np.full(n, SYNTHETIC, np.uint8),
            np.zeros(n, np.uint32),
            np.zeros(n, np.uint16),
        )
    ]
