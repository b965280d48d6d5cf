"""Tiles on a worker: take what a tile needs of the submaps, build it, write it."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path

import numpy as np

from salpcc.pipeline.mapping.map_export import WRITERS, tile_file
from salpcc.pipeline.mapping.map_frame import Frame
from salpcc.pipeline.mapping.map_store import (
    batch_to_entries,
    built_to_table,
    read_blocks,
    table_to_built,
    table_to_views,
)
from salpcc.pipeline.mapping.map_submaps import Submap
from salpcc.pipeline.schedule.machine import peak_mb
from salpcc.pipeline.schedule.store import ShardStore
from salpcc.schemas.work import ShardRef, digest_of
from salpcc.stages.mapping.build import CARVED, DROPPED, OBJECT, Built, build
from salpcc.stages.mapping.carve import REACH
from salpcc.stages.mapping.config import MapConfig
from salpcc.stages.mapping.tiles import Tile
from salpcc.stages.mapping.view import View
from salpcc.stages.mapping.voxel import Voxels

VERSION = 6  # 5: carving weighs what was met; objects go together; 6: keeps that


@dataclass(frozen=True)
class Part:
    """What a tile takes of one submap: blocks of its entries, and its views where they are near."""

    entries: ShardRef
    blocks: tuple[int, ...]
    views: ShardRef | None


@dataclass(frozen=True)
class TileResult:
    """A tile that was built: its shard and its figures. ``ref`` is None where it came out empty."""

    tile: Tile
    ref: ShardRef | None
    kept: int
    carved: int
    dropped: int
    carved_or_dropped: int
    filled: int
    points: int
    cpu_ms: float
    peak_mb: float


def parts_of(tile: Tile, submaps: Sequence[Submap], size: float) -> list[Part]:
    """Choose what a tile needs: blocks that touch it, views within reach of it."""
    parts: list[Part] = []
    for submap in submaps:
        blocks = tuple(i for i, box in enumerate(submap.boxes) if tile in box.tiles(size))
        near = any(tile.distance(np.array(place), size) < REACH for place in submap.viewed)
        if blocks or near:
            parts.append(Part(submap.entries, blocks, submap.views if near else None))
    return parts


def build_tile(
    tile: Tile,
    parts: Sequence[Part],
    sequence: str,
    config: MapConfig,
    formats: Sequence[str],
    frame: Frame,
    out: Path,
) -> TileResult:
    """Build a tile and write it in every format, unless all of it is there."""
    store = ShardStore(out)
    within = config.box(frame.origin)
    digest = digest_of(
        VERSION,
        [asdict(part) for part in parts],
        asdict(tile),
        config.model_dump(mode="json"),
        within and asdict(within),
    )
    ref = ShardRef(f"{sequence}/tile/{tile.name}-{digest[:16]}.arrow", digest)
    facts = store.found(ref)
    if facts is None:
        started = time.process_time()
        corner = tile.corner(config.tile)
        built = build(*_read_parts(store, parts, tile, config), config)
        if within is not None:
            built = built[within.holds(built.voxels.xyz)]
        facts = {
            "stage": "tile",
            "stage_version": VERSION,
            "corner": corner.tolist(),
            **figures_of(built),
            "cpu_ms": 1e3 * (time.process_time() - started),
            "peak_mb": peak_mb(),
        }
        store.write(ref, built_to_table(built, corner), facts)
    figures = {f.name: facts[f.name] for f in fields(TileResult)[2:]}
    if facts["kept"] + facts["carved_or_dropped"] == 0:
        return TileResult(tile, None, **figures)
    paths = [(form, tile_file(out, tile.name, form)) for form in formats if form in WRITERS]
    stamp = stamp_of(out, tile)
    written = digest_of(digest, asdict(frame))
    fresh = stamp.is_file() and stamp.read_text() == written
    missing = [form for form, path in paths if not (fresh and path.is_file())]
    if missing and facts["kept"]:
        started = time.process_time()
        write_products(read_tile(store, ref), tile, config.tile, missing, frame, out)
        stamp.write_text(written)
        figures["cpu_ms"] += 1e3 * (time.process_time() - started)
    return TileResult(tile, ref, **figures)


def stamp_of(out: Path, tile: Tile) -> Path:
    """Return the file that says what the files of a tile were made of."""
    return out / "tiles" / f".{tile.name}"


def figures_of(built: Built) -> dict[str, int]:
    """Count the entries of a tile by what became of them, and the points of those that are in the map."""
    against = built.against
    return {
        "kept": int(np.count_nonzero(against == 0)),
        "carved": int(np.count_nonzero(against & CARVED)),
        "dropped": int(np.count_nonzero(against & (DROPPED | OBJECT))),
        "carved_or_dropped": int(np.count_nonzero(against)),
        "filled": int(np.count_nonzero(built.voxels.count == 0)),
        "points": int(built.voxels.count[against == 0].sum()),
    }


def write_products(
    built: Built, tile: Tile, size: float, formats: Sequence[str], frame: Frame, out: Path
) -> None:
    """Write what is in the map of a tile of ``size`` metres, in those of the formats that have a file a tile."""
    for form in formats:
        if form in WRITERS:
            path = tile_file(out, tile.name, form)
            WRITERS[form](built.voxels[built.against == 0], tile.corner(size), frame, path)


def read_tile(store: ShardStore, ref: ShardRef) -> Built:
    """Read a built tile: all entries, and what became of each."""
    table, facts = store.read(ref)
    return table_to_built(table, facts["corner"])


def _read_parts(
    store: ShardStore, parts: Sequence[Part], tile: Tile, config: MapConfig
) -> tuple[Voxels, list[View]]:
    entries, views = [], []
    for part in parts:
        if part.blocks:
            batches, facts = read_blocks(store, part.entries, part.blocks)
            for batch in batches:
                voxels = batch_to_entries(batch, facts["corner"])
                entries.append(voxels[tile.holds(voxels.xyz, config.tile)])
        if part.views is not None and config.carve:
            near = table_to_views(store.read(part.views)[0])
            views += [v for v in near if tile.distance(v.pose[:3, 3], config.tile) < REACH]
    return Voxels.together(entries), views
