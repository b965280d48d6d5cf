"""Compare two maps of one place: what is gone, what appeared, what stands elsewhere; a table, a picture, and the places in LAZ."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from salpcc.pipeline.mapping.map_export import with_columns
from salpcc.pipeline.mapping.map_frame import Frame, box_around
from salpcc.pipeline.mapping.map_read import read_tile_file
from salpcc.pipeline.mapping.map_summary import frame_of_summary, read_summary
from salpcc.pipeline.mapping.map_write import read_track
from salpcc.schemas.errors import SourceError, UsageError
from salpcc.schemas.files import atomic, write_json
from salpcc.schemas.labels import CLASSES
from salpcc.schemas.version import TOOL
from salpcc.stages.mapping.difference import (
    CHANGED,
    SAME,
    UNSEEN,
    Session,
    align,
    changes,
    moved_objects,
    objects_among,
    turned,
)
from salpcc.stages.mapping.picture import difference_picture
from salpcc.stages.mapping.voxel import SYNTHETIC, Voxels

F64 = NDArray[np.float64]

GONE, APPEARED, MOVED = "gone", "appeared", "moved"
_APART = 0.25  # metres, median: what lies farther apart is not one frame


@dataclass(frozen=True, eq=False)
class _Side:
    """A session, what became of its entries, and the objects among what changed, ``(M,)`` from 1."""

    session: Session
    became: NDArray[np.uint8]
    objects: NDArray[np.uint32]

    def object(self, number: int) -> Voxels:
        return self.session.voxels[self.objects == number]

    def counts(self) -> dict[str, int]:
        return {
            name: int(np.count_nonzero(self.became == what))
            for name, what in (("same", SAME), ("changed", CHANGED), ("not_seen_by_the_other", UNSEEN))
        }


def diff(before: Path, after: Path, out: Path) -> dict[str, Any]:
    """Compare two maps whose poses are of one frame; return what ``OUT/diff.json`` holds, all lengths in metres.

    What one session saw and the other did not is no change. The second map is registered to the first, where that fits better,
    as poses of two sessions lie some centimetres apart.

    Raises:
        UsageError: no map there, or none with LAZ, COPC or PLY tiles; two coordinate systems.
        SourceError: the two lie nowhere on one another.
    """
    frames = [frame_of_summary(read_summary(path)) for path in (before, after)]
    if len({frame.crs for frame in frames} - {None}) > 1:
        raise UsageError(
            f"{before} is in {frames[0].crs}, {after} in {frames[1].crs}; make both in one coordinate system"
        )
    frame = frames[0]
    a, b = _session(before, frame), _session(after, frame)
    pose, apart = align(a, b)
    if apart > _APART:
        raise SourceError(
            f"{after}: does not lie on {before}"
            + (f" ({apart:.2f} m apart)" if np.isfinite(apart) else "")
            + "; make both maps with --poses of one frame"
        )
    b = b.moved(pose)
    sides = []
    for session, other in ((a, b), (b, a)):
        became = changes(session, other)
        sides.append(_Side(session, became, objects_among(session.voxels, became == CHANGED)))
    gone, appeared = sides
    rows = _rows(gone, appeared, frame)
    summary = {
        "version": 1,
        "tool": TOOL,
        "before": str(before),
        "after": str(after),
        "apart_m": round(apart, 4),
        "after_moved_m": round(float(np.linalg.norm(pose[:3, 3])), 4),
        "after_turned_deg": round(turned(pose), 4),
        "voxels": {"before": gone.counts(), "after": appeared.counts()},
        "objects": {kind: sum(row["change"] == kind for row in rows) for kind in (GONE, APPEARED, MOVED)},
        "changes": rows,
    }
    _write(out, gone, appeared, rows, frame)
    write_json(out / "diff.json", summary)
    return summary


def _session(path: Path, frame: Frame) -> Session:
    """Read a map as a session in the frame of another one."""
    summary = read_summary(path)
    own = frame_of_summary(summary)
    parts = [read_tile_file(path, name, own) for name in summary["tiles"]]
    voxels = Voxels.together(parts)
    if not len(voxels):
        raise SourceError(f"{path}: a map of nothing")
    voxels = voxels[voxels.classes != SYNTHETIC]
    poses = read_track(path, frame)
    return Session(
        replace(voxels, xyz=voxels.xyz - np.array(frame.origin)), poses, summary["config"]["voxel"]
    )


def _rows(gone: _Side, appeared: _Side, frame: Frame) -> list[dict[str, Any]]:
    """Return a row for each object that changed, the largest first; ``object`` is its number in the LAZ of its kind."""
    old, new = (
        [side.object(k + 1) for k in range(int(side.objects.max(initial=0)))] for side in (gone, appeared)
    )
    moved = moved_objects(old, new)
    rows = [
        _row(MOVED, m.gone + 1, old[m.gone], frame)
        | {"to": m.appeared + 1, "to_box": box_around(new[m.appeared].xyz, frame), "way_m": round(m.way, 3)}
        for m in moved
    ]
    for kind, objects, taken in (
        (GONE, old, {m.gone for m in moved}),
        (APPEARED, new, {m.appeared for m in moved}),
    ):
        rows += [
            _row(kind, k + 1, voxels, frame)
            for k, voxels in enumerate(objects)
            if k not in taken and len(voxels)
        ]
    return sorted(rows, key=lambda row: -row["voxels"])


def _row(change: str, number: int, voxels: Voxels, frame: Frame) -> dict[str, Any]:
    return {
        "change": change,
        "object": number,
        "class": CLASSES[voxels.kind].name,
        "voxels": len(voxels),
        "box": box_around(voxels.xyz, frame),
    }


def _write(out: Path, gone: _Side, appeared: _Side, rows: list[dict[str, Any]], frame: Frame) -> None:
    """Write the picture, and what is gone and what appeared as LAZ, each point with the number of its object."""
    moved = [row for row in rows if row["change"] == MOVED]
    parts, states = (
        [gone.session.voxels.xyz[gone.became == SAME]],
        [np.zeros(np.count_nonzero(gone.became == SAME), np.uint8)],
    )
    for state, (kind, side, key) in enumerate(((GONE, gone, "object"), (APPEARED, appeared, "to")), start=1):
        changed = side.objects > 0
        voxels, objects = side.session.voxels[changed], side.objects[changed]
        elsewhere = np.isin(objects, [row[key] for row in moved])
        parts.append(voxels.xyz)
        states.append(np.where(elsewhere, 3, state).astype(np.uint8))
        path = out / f"{kind}.laz"
        if len(voxels):
            corner = np.floor(voxels.xyz.min(axis=0))
            columns: dict[str, NDArray[Any]] = {"object": objects, "moved": elsewhere.astype(np.uint8)}
            with_columns(
                voxels,
                corner,
                frame,
                path,
                columns,
                "object: its number in diff.json; moved: 1 where it stands elsewhere",
            )
        else:
            path.unlink(missing_ok=True)
    with atomic(out / "diff.png") as stream:
        stream.write(difference_picture(np.concatenate(parts), np.concatenate(states)))
