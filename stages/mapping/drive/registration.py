"""Register consecutive scans by ICP, as the paper's Table V does, and measure by how much it is off."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from salpcc.stages.mapping.open3d_library import load_open3d

F64 = NDArray[np.float64]
Method = Literal["point", "plane"]
METHODS: dict[str, Method] = {"point to point": "point", "point to plane": "plane"}  # as tables call them

ROUNDS = 200  # of ICP, as in the paper
REACH = 1.0  # metres, farther pairs do not count
RESOLUTION = 1.0  # metres, d_res of eq. (27)
_NORMALS = (1.0, 30)  # metres, and neighbours at most, that a normal is taken from


def rotation_error(found: F64, truth: F64) -> float:
    """Return the angle between two poses ``(4, 4)`` in degrees, eq. (26).

    From the sine and cosine both: the arc cosine alone knows no angle below 1e-6 degrees.
    """
    turn = found[:3, :3] @ truth[:3, :3].T
    skew = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]) / 2
    return float(np.degrees(np.arctan2(np.linalg.norm(skew), (np.trace(turn) - 1) / 2)))


def translation_error(found: F64, truth: F64) -> float:
    """Return the distance between two poses ``(4, 4)`` in units of :data:`RESOLUTION`, eq. (27)."""
    return float(np.linalg.norm(found[:3, 3] - truth[:3, 3]) / RESOLUTION)


def icp(source: NDArray[np.floating], target: NDArray[np.floating], method: Method) -> F64:
    """Return the pose ``(4, 4)`` that takes ``source`` onto ``target`` ``(N, 3)``, by Open3D, from no motion.

    No start is given: that is the test of the paper, and things that drive along are what misleads it.
    """
    open3d = load_open3d()
    fixed, moving = _cloud(open3d, target), _cloud(open3d, source)
    rules = open3d.pipelines.registration
    estimate = rules.TransformationEstimationPointToPoint()
    if method == "plane":
        radius, most = _NORMALS
        fixed.estimate_normals(open3d.geometry.KDTreeSearchParamHybrid(radius, most))
        estimate = rules.TransformationEstimationPointToPlane()
    end = rules.ICPConvergenceCriteria(relative_fitness=1e-6, relative_rmse=1e-6, max_iteration=ROUNDS)
    return np.array(rules.registration_icp(moving, fixed, REACH, np.eye(4), estimate, end).transformation)


def _cloud(open3d: Any, points: NDArray[np.floating]) -> Any:
    return open3d.geometry.PointCloud(open3d.utility.Vector3dVector(np.ascontiguousarray(points, np.float64)))
