"""Why was this removed: what a map left out, as tiles of its own, each point with reason, witnesses and score; a picture."""

from __future__ import annotations

from pathlib import Path

import laspy
import numpy as np
from numpy.typing import NDArray

from salpcc.pipeline.export.las import coordinate_system, text_record
from salpcc.pipeline.mapping.map_frame import Frame, frame_of
from salpcc.pipeline.mapping.map_plan import MapPlan
from salpcc.pipeline.mapping.map_request import MapRequest
from salpcc.pipeline.mapping.map_tiles import TileResult, read_tile
from salpcc.pipeline.schedule.store import ShardStore
from salpcc.schemas.files import atomic
from salpcc.stages.mapping.build import CARVED, DROPPED, OBJECT, Built
from salpcc.stages.mapping.picture import removed_picture
from salpcc.stages.mapping.voxel import Voxels

F64 = NDArray[np.float64]

FOLDER = "removed"
PICTURE = "pictures/removed.png"
_SCALE = 0.001  # metres
_REASONS = f"reason, as bits: {CARVED} seen through, {DROPPED} of a movable class, {OBJECT} among what is"
_WITNESSES = (
    "through: scans that looked through it; met: scans whose view ended there; scans: that had a return in it"
)
_SCORE = "score: through / (through + met), 1 where classes alone speak against it"


def explain(request: MapRequest, plan: MapPlan, store: ShardStore, tiles: list[TileResult]) -> None:
    """Write what was removed: ``OUT/removed/TILE.laz``, and ``OUT/pictures/removed.png``, seen from above."""
    frame = frame_of(plan.origin, request.archives[0], request.crs)
    folder = request.out / FOLDER
    parts, reasons = [], [np.empty(0, np.uint8)]
    for tile in tiles:
        if tile.ref is None or not tile.carved_or_dropped:
            continue
        built = read_tile(store, tile.ref)
        removed = built[built.against != 0]
        _write(removed, tile.tile.corner(request.config.tile), frame, folder / f"{tile.tile.name}.laz")
        parts.append(removed.voxels)
        reasons.append(removed.against)
    png = removed_picture(Voxels.together(parts), np.concatenate(reasons))
    with atomic(request.out / PICTURE) as stream:
        stream.write(png)


def clear_explained(out: Path) -> None:
    """Delete what explains an older map in the same folder."""
    for old in (*(out / FOLDER).glob("*.laz"), out / PICTURE):
        old.unlink(missing_ok=True)


def score_of(built: Built) -> NDArray[np.float32]:
    """Return how sure it is ``(M,)`` that what was removed was not there: 0 to 1."""
    through, met = built.through.astype(np.float32), built.met.astype(np.float32)
    share = through / np.maximum(through + met, 1)
    return np.where(built.against & CARVED, share, np.float32(1)).astype(np.float32)


def _write(removed: Built, corner: F64, frame: Frame, path: Path) -> None:
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.scales, header.offsets = np.full(3, _SCALE), np.floor(corner + np.array(frame.origin))
    if frame.crs:
        header.add_crs(coordinate_system(frame.crs))
    for name, kind in (
        ("reason", np.uint8), ("through", np.uint16), ("met", np.uint16), ("scans", np.uint16), ("score", np.float32),
    ):  # fmt: skip
        header.add_extra_dim(laspy.ExtraBytesParams(name, kind))
    header.vlrs.append(text_record(_REASONS, _WITNESSES, _SCORE))
    las = laspy.LasData(header)
    las.xyz = removed.voxels.xyz + np.array(frame.origin)
    las.user_data = removed.voxels.classes
    las.reason, las.through, las.met = removed.against, removed.through, removed.met
    las.scans, las.score = removed.voxels.scans, score_of(removed)
    with atomic(path) as stream:
        las.write(stream, do_compress=True)
