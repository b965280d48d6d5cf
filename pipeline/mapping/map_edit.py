"""Put back into a map what was removed of it, and write it anew; said in ``map.json``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from salpcc.pipeline.mapping.map_explain import (
    OBJECTS,
    Explained,
    drop_older,
    read_explained,
    write_explained,
)
from salpcc.pipeline.mapping.map_summary import (
    explained_of_summary,
    explained_to_json,
    figures_of_map,
    frame_of_summary,
    read_summary,
    write_summary,
)
from salpcc.pipeline.mapping.map_tiles import TileResult, stamp_of, write_products
from salpcc.pipeline.mapping.map_write import Whole, read_track, write_whole
from salpcc.pipeline.schedule.lock import locked
from salpcc.pipeline.schedule.store import ShardStore
from salpcc.schemas.errors import ShardError, UsageError
from salpcc.stages.evaluate.report import record
from salpcc.stages.evaluate.report.schema import MAP_QUALITY
from salpcc.stages.mapping.tiles import Box


@dataclass(frozen=True)
class Restored:
    """What is put back: the objects of these numbers, and what lies in these boxes of the frame of the poses."""

    objects: tuple[int, ...] = ()
    boxes: tuple[Box, ...] = ()

    def told(self) -> dict[str, list[Any]]:
        """Return what ``map.json`` says of it."""
        return {"objects": list(self.objects), "boxes": [list(box.numbers) for box in self.boxes]}

    def marks(self, explained: Explained, origin: Sequence[float]) -> NDArray[np.bool_]:
        """Mark for each object, then each box ``(K, M)``, the entries of a tile that it puts back."""
        xyz, gone = explained.built.voxels.xyz + np.array(origin), explained.built.against != 0
        by_number = [explained.objects == number for number in self.objects]
        return np.asarray(np.array([*by_number, *(box.holds(xyz) for box in self.boxes)]) & gone)


def restore(out: Path, restored: Restored, command: str = "") -> dict[str, Any]:
    """Put entries that were removed back into the map in ``out``, and write it anew; return what ``map.json`` then holds.

    A file appears whole or is what it was, and ``map.json`` comes last: interrupted, the same command ends the same.

    Raises:
        UsageError: no map there; one that keeps nothing of what was removed; an object or a box with nothing to put back.
        ShardError: what was removed is damaged or gone.
    """
    with locked(out):
        summary = read_summary(out)
        if not summary.get("explained"):
            raise UsageError(
                f"{out}: nothing that was removed is kept there; make the map again with --explain"
            )
        store, frame, size = ShardStore(out), frame_of_summary(summary), float(summary["config"]["tile"])
        store.sweep()
        tiles = explained_of_summary(summary)
        counts = [restored.marks(_read(store, tile), frame.origin).sum(axis=1) for tile in tiles]
        _refuse_nothing(out, restored, np.sum(counts, axis=0))
        for at in np.flatnonzero([count.any() for count in counts]):
            explained = _read(store, tiles[at])
            put_back = restored.marks(explained, frame.origin).any(axis=0)
            built = replace(explained.built, against=np.where(put_back, np.uint8(0), explained.built.against))
            of = (asdict(tiles[at]), restored.told())
            new = write_explained(
                store, summary["sequence"], tiles[at], replace(explained, built=built), size, *of
            )
            stamp_of(out, new.tile).unlink(missing_ok=True)  # what was built is not what is written now
            write_products(built, new.tile, size, summary["formats"], frame, out)
            tiles[at] = new
        whole = Whole(summary["sequence"], summary["scans"], tuple(summary["formats"]), size, frame, True)
        write_whole(out, whole, store, tiles, read_track(out, frame))
        record.record(
            out, map_quality=MAP_QUALITY.empty_table()
        )  # it is another map than the one that was scored
        before = summary["voxels"]["kept"]
        summary |= {**figures_of_map(tiles), "explained": explained_to_json(tiles), "quality": []}
        edit = {
            "restored": restored.told(),
            "voxels": summary["voxels"]["kept"] - before,
            "when": datetime.now(UTC).isoformat(timespec="seconds"),
            "command": command,
        }
        summary["edits"] = [*summary["edits"], edit]
        write_summary(out, summary)
        drop_older(store, summary["sequence"], tiles)
    return summary


def _read(store: ShardStore, tile: TileResult) -> Explained:
    assert tile.ref is not None  # a tile that nothing lies in is not listed
    try:
        return read_explained(store, tile.ref)
    except ShardError as error:
        raise ShardError(
            f"{store.root / tile.ref.path}: damaged or gone, and with it what was removed; make the map again"
        ) from error


def _refuse_nothing(out: Path, restored: Restored, counts: NDArray[np.int64]) -> None:
    what = [f"object {number}" for number in restored.objects]
    what += [",".join(f"{v:g}" for v in box.numbers) for box in restored.boxes]
    for name, count in zip(what, counts, strict=True):
        if not count:
            raise UsageError(
                f"--restore {name}: nothing of that is removed; {out / OBJECTS} lists what is, with its box"
            )
