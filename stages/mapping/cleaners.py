"""Public cleaners of maps, to compare with: each tells which points of each scan it would keep.

A cleaner takes scans as pairs of points ``(N, 3)`` float32 in the sensor's frame and poses ``(4, 4)``, and gives one
mask ``(N,)`` a scan. They hold a whole sequence in memory and import their packages inside.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from importlib.util import find_spec

import numpy as np
from numpy.typing import NDArray

from salpcc.schemas.errors import UsageError
from salpcc.stages.mapping.drive.poses import move

Placed = tuple[NDArray[np.float32], NDArray[np.float64]]
Masks = list[NDArray[np.bool_]]

# Duberg et al., DUFOMap, IEEE RA-L 2024: its own settings for a 64-beam sensor.
_DUFO_VOXEL, _DUFO_HIT, _DUFO_UNKNOWN = 0.1, 0.2, 2
# Hornung et al., OctoMap, Autonomous Robots 2013; all else is its default.
_OCTO_VOXEL, _OCCUPIED = 0.1, 1


def _dufomap(scans: Sequence[Placed]) -> Masks:
    """DUFOMap: dynamic is what lies where a scan has certainly seen nothing."""
    from dufomap import dufomap

    cleaner = dufomap(_DUFO_VOXEL, _DUFO_HIT, _DUFO_UNKNOWN, num_threads=1)
    for points, pose in scans:
        cleaner.run(points, pose, cloud_transform=True)
    cleaner.oncePropagateCluster(if_propagate=True, if_cluster=False)
    return [
        np.asarray(cleaner.segment(points, pose, cloud_transform=True)).ravel() == 0 for points, pose in scans
    ]


def _octomap(scans: Sequence[Placed]) -> Masks:
    """OctoMap: dynamic is what lies where more rays passed than ended, each weighed as its authors do."""
    from octomap import OcTree

    tree = OcTree(_OCTO_VOXEL)
    for points, pose in scans:
        tree.insertPointCloud(move(points, pose), pose[:3, 3].copy(), lazy_eval=True)
    tree.updateInnerOccupancy()
    return [np.asarray(tree.getLabels(move(points, pose))).ravel() == _OCCUPIED for points, pose in scans]


CLEANERS: Mapping[str, Callable[[Sequence[Placed]], Masks]] = {"dufomap": _dufomap, "octomap": _octomap}


def cleaner(name: str) -> Callable[[Sequence[Placed]], Masks]:
    """Return a cleaner by name.

    Raises:
        UsageError: unknown, or its package is missing.
    """
    if name not in CLEANERS:
        raise UsageError(f"--rivals {name}: choose from {', '.join(CLEANERS)}")
    if find_spec(name) is None:
        raise UsageError(f"--rivals {name}: its package is missing, pip install 'salpcc-pipeline[baselines]'")
    return CLEANERS[name]
