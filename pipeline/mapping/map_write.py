"""Write what is one for a whole map: the MCAP, the poses, pictures and records for the report."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from salpcc.pipeline.mapping.map_explain import clear_explained, explain
from salpcc.pipeline.mapping.map_export import tile_file, to_mcap
from salpcc.pipeline.mapping.map_frame import Frame
from salpcc.pipeline.mapping.map_index import INDEX, write_index
from salpcc.pipeline.mapping.map_plan import F64, MapPlan
from salpcc.pipeline.mapping.map_request import MapRequest
from salpcc.pipeline.mapping.map_tiles import TileResult, read_tile
from salpcc.pipeline.schedule.store import ShardStore
from salpcc.schemas.errors import UsageError
from salpcc.schemas.files import atomic, there
from salpcc.stages.evaluate.report import record
from salpcc.stages.evaluate.report.schema import PICTURES
from salpcc.stages.mapping.picture import busiest, pictures
from salpcc.stages.mapping.voxel import Voxels

_SAMPLE = 4_000_000  # entries at most that are drawn


@dataclass(frozen=True)
class Whole:
    """What all files of a map have in common.

    Attributes:
        size: of its tiles, metres.
        explained: whether what was removed is written, too.
    """

    sequence: str
    n_scans: int
    formats: tuple[str, ...]
    size: float
    frame: Frame
    explained: bool


def check_place(out: Path) -> None:
    """Refuse a folder in which a map would take the place of files of the drive, such as its poses.

    Raises:
        UsageError: one is there, and the folder is no map's.
    """
    if not any((out / name).exists() for name in ("scans.txt", "map.json")):
        for name in ("poses.txt", "map.mcap", "map.vpc"):
            if there(out / name):
                raise UsageError(
                    f"{out}: its {name} is of no map, and one would replace it; name another folder"
                )


def write_track(out: Path, plan: MapPlan, scans: F64) -> None:
    """Write where the scans stand, ``(n, 4, 4)`` in the map's frame, as poses.txt in the frame of the poses, and their names; inverse: :func:`read_track`."""
    placed = scans.copy()
    placed[:, :3, 3] += plan.origin
    lines = [" ".join(f"{value:.12e}" for value in pose[:3].ravel()) for pose in placed]
    names = [name for group in plan.groups for name in group.names]
    for file, rows in (("scans.txt", names), ("poses.txt", lines)):
        with atomic(out / file) as stream:
            stream.write(("\n".join(rows) + "\n").encode())


def read_track(out: Path, frame: Frame) -> F64:
    """Read where the scans of a map stand ``(n, 4, 4)`` in its frame."""
    scans = np.tile(np.eye(4), (len(rows := np.loadtxt(out / "poses.txt", ndmin=2)), 1, 1))
    scans[:, :3] = rows.reshape(-1, 3, 4)
    scans[:, :3, 3] -= frame.origin
    return scans


def write_whole(out: Path, whole: Whole, store: ShardStore, tiles: Sequence[TileResult], scans: F64) -> None:
    """Write what is one for the whole map: the MCAP, the index of its tiles, what was removed, pictures; ``scans`` as in :func:`write_track`."""
    if "mcap" in whole.formats:
        to_mcap(_kept(store, tiles), whole.frame, out / "map.mcap")
    else:
        (out / "map.mcap").unlink(missing_ok=True)
    indexed = next((form for form in ("copc", "laz") if form in whole.formats), None)
    if indexed is not None:
        files = [tile_file(out, tile.tile.name, indexed) for tile in tiles if tile.kept]
        write_index(out, files, whole.frame.crs)
    else:
        (out / INDEX).unlink(missing_ok=True)
    if whole.explained:
        explain(out, store, tiles, whole.size, whole.frame)
    else:
        clear_explained(out)
    voxels, against = _sample(store, tiles)
    drawn = pictures(voxels, against, busiest(scans, voxels.xyz, against))
    for name, png in drawn.items():
        with atomic(out / "pictures" / f"{name}.png") as stream:
            stream.write(png)
    record.record(out, pictures=pa.Table.from_pylist(_captioned(whole, drawn), schema=PICTURES))


def _kept(store: ShardStore, tiles: Sequence[TileResult]) -> Iterator[Voxels]:
    for tile in tiles:
        if tile.ref is not None and tile.kept:
            built = read_tile(store, tile.ref)
            yield built.voxels[built.against == 0]


def _sample(store: ShardStore, tiles: Sequence[TileResult]) -> tuple[Voxels, NDArray[np.uint8]]:
    """Take evenly spaced entries of all tiles, as many as can be drawn."""
    total = sum(t.kept + t.carved_or_dropped for t in tiles)
    every = max(1, -(-total // _SAMPLE))
    parts, fates = [], [np.empty(0, np.uint8)]
    for tile in tiles:
        if tile.ref is not None:
            built = read_tile(store, tile.ref)
            parts.append(built.voxels[::every])
            fates.append(built.against[::every])
    return Voxels.together(parts), np.concatenate(fates)


def _captioned(whole: Whole, drawn: dict[str, bytes]) -> list[dict[str, object]]:
    where = {"above": "from above", "perspective": "in perspective"}
    what = {
        "before": "all decoded scans laid together; red: of a movable class, orange: seen through by later or "
        "earlier scans; other colours: height",
        "after": "the same view of the clean map; colours: height, blue: filled-in ground",
    }
    rows: list[dict[str, object]] = []
    for name, png in drawn.items():
        view, state = name.split("_")
        title = f"Sequence {whole.sequence}, {where[view]}, {state}"
        caption = f"{whole.n_scans} scans, {what[state]}."
        rows.append(
            {"figure": "fig10", "group": whole.sequence, "title": title, "caption": caption, "png": png}
        )
    return rows


def clear(request: MapRequest, names: set[str]) -> None:
    """Delete tiles of an older map in the same folder."""
    wanted = {tile_file(request.out, name, form).name for name in names for form in request.formats}
    wanted |= {f".{name}" for name in names}
    for path in (request.out / "tiles").glob("*"):
        if path.name not in wanted:
            path.unlink()
