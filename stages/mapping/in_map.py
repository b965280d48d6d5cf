"""Localise a scan in a map: register it to what the map has around, from where the scan before was."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import small_gicp
from numpy.typing import NDArray

from salpcc.stages.mapping.drive.poses import proper
from salpcc.stages.mapping.drive.registration import Method

F64 = NDArray[np.float64]

_REACHES = (3.0, 1.0)  # metres: pairs farther apart do not count, first to get near, then to fit
_ROUNDS = 60
_NEIGHBOURS = 12  # that a normal is taken from
_THIN = 0.3  # metres, between the points of a scan
_KINDS: dict[Method, str] = {"point": "ICP", "plane": "PLANE_ICP"}
FEWEST = 100  # points that a registration needs


@dataclass(frozen=True, eq=False)
class Surroundings:
    """What of a map scans are registered to."""

    cloud: small_gicp.PointCloud
    tree: small_gicp.KdTree

    @classmethod
    def of(cls, xyz: F64) -> Surroundings | None:
        """Take the places ``(M, 3)`` of a map, None where too few are there."""
        if len(xyz) < FEWEST:
            return None
        cloud, tree = small_gicp.preprocess_points(xyz, 0.01, _NEIGHBOURS, 1)
        return cls(cloud, tree)

    def localise(self, points: F64, start: F64, method: Method) -> F64 | None:
        """Return the pose ``(4, 4)`` of a scan's points ``(N, 3)`` in the map, None of too few points.

        Args:
            start: ``(4, 4)`` to begin from.
            method: point to point, or point to plane.
        """
        scan = small_gicp.voxelgrid_sampling(points, _THIN, 1)
        if scan.size() < FEWEST:
            return None
        pose = start
        for reach in _REACHES:
            found = small_gicp.align(
                self.cloud, scan, self.tree, pose,
                registration_type=_KINDS[method], max_correspondence_distance=reach, num_threads=1, max_iterations=_ROUNDS,
            )  # fmt: skip
            pose = proper(np.asarray(found.T_target_source, np.float64))
        return pose
