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

Placed = tuple[NDArray[np.float32], NDArray[np.float64]]
Masks = list[NDArray[np.bool_]]

# Duberg et al., DUFOMap, IEEE RA-L 2024: its own settings for a 64-beam sensor.
_DUFO_VOXEL, _DUFO_HIT, _DUFO_UNKNOWN = 0.1, 0.2, 2


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


CLEANERS: Mapping[str, Callable[[Sequence[Placed]], Masks]] = {"dufomap": _dufomap}


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
