"""Read what is in a map from its files."""

from __future__ import annotations

from pathlib import Path

import laspy
import numpy as np
from plyfile import PlyData

from salpcc.pipeline.mapping.map_export import tile_file
from salpcc.pipeline.mapping.map_frame import Frame
from salpcc.schemas.errors import UsageError
from salpcc.stages.mapping.voxel import Voxels


def read_tile_file(out: Path, name: str, frame: Frame) -> Voxels:
    """Read places, in the frame of the poses, intensities and classes of a tile, from whichever of its files is there.

    Raises:
        UsageError: neither LAZ, COPC nor PLY.
    """
    for path in (tile_file(out, name, form) for form in ("laz", "copc")):
        if path.is_file():
            las = laspy.read(path)
            return Voxels.of_points(
                np.array(las.xyz), np.array(las.mean_intensity), np.array(las.user_data, np.uint8)
            )
    ply = tile_file(out, name, "ply")
    if not ply.is_file():
        raise UsageError(f"{out}: no tile {name} in LAZ, COPC or PLY; make the map with --formats laz")
    rows = PlyData.read(ply)["vertex"].data
    xyz = np.column_stack([rows[axis] for axis in "xyz"]).astype(np.float64) + np.array(frame.origin)
    return Voxels.of_points(xyz, rows["intensity"].copy(), rows["class"].copy())
