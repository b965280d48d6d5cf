"""Why was this removed: what a map left out, as tiles of its own, each point with object, reason, witnesses and score.

A map that is explained keeps a shard a tile, of what is in it and what is not, from which :mod:`.map_edit` makes it again.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from salpcc.pipeline.mapping.map_export import with_columns
from salpcc.pipeline.mapping.map_frame import Frame, box_around
from salpcc.pipeline.mapping.map_store import TILE, built_to_table, table_to_built
from salpcc.pipeline.mapping.map_tiles import TileResult, figures_of, read_tile
from salpcc.pipeline.schedule.store import ShardStore
from salpcc.schemas.files import atomic
from salpcc.schemas.labels import CLASSES
from salpcc.schemas.work import ShardRef, digest_of
from salpcc.stages.mapping.build import CARVED, DROPPED, OBJECT, Built
from salpcc.stages.mapping.clusters import objects_of
from salpcc.stages.mapping.picture import removed_picture

F64 = NDArray[np.float64]

FOLDER, OBJECTS = "removed", "removed/objects.json"
PICTURE = "pictures/removed.png"
STAGE, _VERSION = "explained", 1
_EXPLAINED = pa.schema([*TILE, ("object", pa.uint32())])
_REASONS = f"reason, as bits: {CARVED} seen through, {DROPPED} of a movable class, {OBJECT} among what is"
_WITNESSES = (
    "through: scans that looked through it; met: scans whose view ended there; scans: that had a return in it"
)
_SCORE = "score: through / (through + met), 1 where classes alone speak against it"
_OBJECT = f"object: what hangs together has one number, see {OBJECTS}; `map edit --restore` takes it"


@dataclass(frozen=True, eq=False)
class Explained:
    """A tile with what was removed of it.

    Attributes:
        built: all entries.
        objects: ``(M,)`` uint32, the number of the object that an entry was removed with; 0 where it never was.
    """

    built: Built
    objects: NDArray[np.uint32]


def keep(store: ShardStore, sequence: str, tiles: Sequence[TileResult], size: float) -> list[TileResult]:
    """Number what was removed by objects, and keep it; return the tiles with the shards that have it."""
    full = [tile.ref for tile in tiles if tile.ref is not None]
    removed = [_removed_of(read_tile(store, ref)) for ref in full]
    numbers = objects_of(np.concatenate([np.empty((0, 3)), *removed]))
    by_tile = dict(zip(full, np.split(numbers, np.cumsum([len(part) for part in removed])[:-1]), strict=True))
    kept = []
    for tile in tiles:
        if tile.ref is not None:
            built = read_tile(store, tile.ref)
            objects = np.zeros(len(built.against), np.uint32)
            objects[built.against != 0] = by_tile[tile.ref]
            tile = write_explained(store, sequence, tile, Explained(built, objects), size, tile.ref.digest)
        kept.append(tile)
    return kept


def _removed_of(built: Built) -> F64:
    return np.asarray(built.voxels.xyz[built.against != 0])


def write_explained(
    store: ShardStore, sequence: str, tile: TileResult, explained: Explained, size: float, *of: object
) -> TileResult:
    """Write a tile's shard, named by what it was made ``of``; inverse: :func:`read_explained`."""
    digest = digest_of(_VERSION, STAGE, *of)
    ref = ShardRef(f"{sequence}/{STAGE}/{tile.tile.name}-{digest[:16]}.arrow", digest)
    corner = tile.tile.corner(size)  # the same as before: float32 places stay what they are
    columns = [*built_to_table(explained.built, corner).columns, pa.array(explained.objects)]
    facts = {"stage": STAGE, "stage_version": _VERSION, "corner": corner.tolist()}
    store.write(ref, pa.Table.from_arrays(columns, schema=_EXPLAINED), facts)
    return replace(tile, ref=ref, **cast(dict[str, Any], figures_of(explained.built)))


def read_explained(store: ShardStore, ref: ShardRef) -> Explained:
    """Read a tile's shard.

    Raises:
        ShardError: missing or damaged.
    """
    table, facts = store.read(ref)
    return Explained(table_to_built(table, facts["corner"]), np.array(table.column("object")))


def drop_older(store: ShardStore, sequence: str, tiles: Sequence[TileResult]) -> None:
    """Delete the shards of explained tiles that are not of ``tiles``."""
    named = {store.root / tile.ref.path for tile in tiles if tile.ref is not None}
    if not named:
        store.drop_sequence(sequence, (STAGE,))
    for path in set((store.root / sequence / STAGE).glob("*.arrow")) - named:
        path.unlink()


def explain(out: Path, store: ShardStore, tiles: Sequence[TileResult], size: float, frame: Frame) -> None:
    """Write what was removed: ``OUT/removed/TILE.laz``, its objects, and ``OUT/pictures/removed.png``, seen from above."""
    clear_explained(out)
    parts, numbers = [], []
    for tile in tiles:
        if tile.ref is None or not tile.carved_or_dropped:
            continue
        explained = read_explained(store, tile.ref)
        removed, gone = explained.built, explained.built.against != 0
        removed, objects = removed[gone], explained.objects[gone]
        columns = {
            "object": objects,
            "reason": removed.against,
            "through": removed.through,
            "met": removed.met,
            "scans": removed.voxels.scans,
            "score": score_of(removed),
        }
        path = out / FOLDER / f"{tile.tile.name}.laz"
        texts = (_OBJECT, _REASONS, _WITNESSES, _SCORE)
        with_columns(removed.voxels, tile.tile.corner(size), frame, path, columns, *texts)
        parts.append(removed)
        numbers.append(objects)
    whole = Built.together(parts)
    objects = np.concatenate([np.empty(0, np.uint32), *numbers])
    with atomic(out / OBJECTS) as stream:
        rows = ",\n ".join(json.dumps(row) for row in table_of(whole, objects, frame))
        stream.write(f"[{rows}]\n".encode())
    with atomic(out / PICTURE) as stream:
        stream.write(removed_picture(whole.voxels, whole.against, objects))


def clear_explained(out: Path) -> None:
    """Delete what explains an older map in the same folder."""
    for old in (*(out / FOLDER).glob("*.laz"), out / OBJECTS, out / PICTURE):
        old.unlink(missing_ok=True)


def score_of(built: Built) -> NDArray[np.float32]:
    """Return how sure it is ``(M,)`` that what was removed was not there: 0 to 1."""
    through, met = built.through.astype(np.float32), built.met.astype(np.float32)
    share = through / np.maximum(through + met, 1)
    return np.where(built.against & CARVED, share, np.float32(1)).astype(np.float32)


def table_of(removed: Built, objects: NDArray[np.uint32], frame: Frame) -> list[dict[str, Any]]:
    """Return a row for each object that was removed: its number, class, voxels by reason, score, and box in the frame of the poses."""
    order = np.argsort(objects, kind="stable")
    starts = np.flatnonzero(np.diff(objects[order], prepend=0))
    return [
        _row(removed[part], int(objects[part[0]]), frame) for part in np.split(order, starts[1:]) if len(part)
    ]


def _row(removed: Built, number: int, frame: Frame) -> dict[str, Any]:
    against = removed.against
    return {
        "object": number,
        "class": CLASSES[removed.voxels.kind].name,
        "voxels": len(against),
        "seen_through": int(np.count_nonzero(against & CARVED)),
        "of_movable_class": int(np.count_nonzero(against & DROPPED)),
        "among_movable": int(np.count_nonzero(against & OBJECT)),
        "score": round(float(score_of(removed).mean()), 3),
        "box": box_around(removed.voxels.xyz, frame),
    }
