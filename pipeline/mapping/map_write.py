"""Write what is one for a whole map: the MCAP, the poses, pictures and records for the report."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from salpcc.pipeline.mapping.map_explain import clear_explained, explain
from salpcc.pipeline.mapping.map_export import to_mcap
from salpcc.pipeline.mapping.map_frame import frame_of
from salpcc.pipeline.mapping.map_plan import F64, MapPlan
from salpcc.pipeline.mapping.map_request import MapRequest
from salpcc.pipeline.mapping.map_tiles import TileResult, read_tile
from salpcc.pipeline.schedule.store import ShardStore
from salpcc.schemas.files import atomic
from salpcc.stages.evaluate.report import record
from salpcc.stages.evaluate.report.schema import MAP_QUALITY, PICTURES
from salpcc.stages.mapping.picture import busiest, pictures
from salpcc.stages.mapping.voxel import Voxels

_SAMPLE = 4_000_000  # entries at most that are drawn


def write_whole(
    request: MapRequest,
    plan: MapPlan,
    store: ShardStore,
    tiles: list[TileResult],
    scans: F64,
    rows: list[dict[str, Any]],
) -> None:
    """Write what is one for the whole map: the MCAP, the scans' poses, pictures and records for the report."""
    placed = scans.copy()
    placed[:, :3, 3] += plan.origin
    lines = [" ".join(f"{value:.12e}" for value in pose[:3].ravel()) for pose in placed]
    names = [name for group in plan.groups for name in group.names]
    with atomic(request.out / "poses.txt") as stream:
        stream.write(("\n".join(lines) + "\n").encode())
    with atomic(request.out / "scans.txt") as stream:
        stream.write(("\n".join(names) + "\n").encode())
    if "mcap" in request.formats:
        to_mcap(
            _kept(store, tiles),
            frame_of(plan.origin, request.archives[0], request.crs),
            request.out / "map.mcap",
        )
    else:
        (request.out / "map.mcap").unlink(missing_ok=True)
    clear_explained(request.out)
    if request.explain:
        explain(request, plan, store, tiles)
    voxels, against = _sample(store, tiles)
    drawn = pictures(voxels, against, busiest(scans, voxels.xyz, against))
    for name, png in drawn.items():
        with atomic(request.out / "pictures" / f"{name}.png") as stream:
            stream.write(png)
    tables = {"pictures": pa.Table.from_pylist(_captioned(plan, drawn), schema=PICTURES)}
    if rows:
        tables["map_quality"] = pa.Table.from_pylist(rows, schema=MAP_QUALITY)
    record.record(request.out, **tables)


def _kept(store: ShardStore, tiles: list[TileResult]) -> Iterator[Voxels]:
    for tile in tiles:
        if tile.ref is not None and tile.kept:
            built = read_tile(store, tile.ref)
            yield built.voxels[built.against == 0]


def _sample(store: ShardStore, tiles: list[TileResult]) -> tuple[Voxels, NDArray[np.uint8]]:
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


def _captioned(plan: MapPlan, drawn: dict[str, bytes]) -> list[dict[str, object]]:
    where = {"above": "from above", "perspective": "in perspective"}
    what = {
        "before": "all decoded scans laid together; red: of a movable class, orange: seen through by later or "
        "earlier scans; other colours: height",
        "after": "the same view of the clean map; colours: height, blue: filled-in ground",
    }
    rows: list[dict[str, object]] = []
    for name, png in drawn.items():
        view, state = name.split("_")
        title = f"Sequence {plan.sequence}, {where[view]}, {state}"
        caption = f"{plan.n_scans} scans, {what[state]}."
        rows.append(
            {"figure": "fig10", "group": plan.sequence, "title": title, "caption": caption, "png": png}
        )
    return rows


def clear(request: MapRequest, names: set[str]) -> None:
    """Delete tiles of an older map in the same folder."""
    wanted = {f"{name}.{form}" for name in names for form in request.formats} | {f".{n}" for n in names}
    for path in (request.out / "tiles").glob("*"):
        if path.name not in wanted:
            path.unlink()
