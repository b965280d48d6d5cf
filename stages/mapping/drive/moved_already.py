"""Were scans moved to one instant before they were recorded? Then to de-skew them would move them twice.

Many drivers do it, and leave the points their times. It is told by which fits better: where the drive was fastest, scans are
registered to one another as they are, and what then lies between them is compared with what does when they are de-skewed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from salpcc.stages.mapping.drive.deskew import fastest, motions_of
from salpcc.stages.mapping.drive.odometry import Registered, Thinned, follow
from salpcc.stages.mapping.drive.refine import residual

F64 = NDArray[np.float64]

_STRETCH = 24  # scans that are looked at
_FIRST, _JUDGED = (
    4,
    8,
)  # of them that are not judged, as hardly any are before them; and how many of the others are
_SLOW = 0.2  # metres per turn, below which both are the same
_CLEARLY = 0.97  # of the residual of de-skewed scans, below which they were moved already


def moved_already(
    clouds: Sequence[Callable[[], Thinned]], found: Sequence[Registered], numbers: Sequence[int]
) -> bool:
    """Tell whether scans without a motion of their own fit one another better as they are than de-skewed.

    Args:
        clouds: give the scans of a drive.
        found: their poses, found with each de-skewed.
        numbers: count turns.
    """
    poses = np.array([scan.pose for scan in found])
    motions = motions_of(poses, numbers)
    part = fastest(motions, _STRETCH)
    if np.linalg.norm(motions[part, :3], axis=1).mean() < _SLOW:
        return False
    skewed = [cloud() for cloud in clouds[part]]
    if any(cloud.compensated for cloud in skewed):
        return False  # some tell their motion, and need no guess
    as_they_are = [still(cloud) for cloud in skewed]
    first = min(_FIRST, len(skewed) - 1)
    spots = sorted({int(k) for k in np.linspace(first, len(skewed) - 1, _JUDGED).round()})
    own = np.array([scan.pose for scan in follow(as_they_are)])
    moved = residual(skewed.__getitem__, spots, poses[part], motions[part])
    left = residual(as_they_are.__getitem__, spots, own, np.zeros((len(own), 6)))
    return moved is not None and left is not None and left < _CLEARLY * moved


def still(cloud: Thinned) -> Thinned:
    """Return a scan of which nothing is de-skewed, whatever its motion."""
    return replace(cloud, before=np.zeros_like(cloud.before))
