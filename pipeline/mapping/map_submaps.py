"""Submaps on a worker: a group of scans, de-skewed and placed, as one cloud."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from salpcc.pipeline.mapping.map_plan import Group
from salpcc.pipeline.mapping.map_scans import content_of, scans_of
from salpcc.pipeline.mapping.map_store import (
    ENTRIES,
    entries_to_batch,
    views_to_table,
    whole_metres,
    write_blocks,
)
from salpcc.pipeline.schedule.machine import peak_mb
from salpcc.pipeline.schedule.store import ShardStore
from salpcc.schemas.work import ShardRef, digest_of
from salpcc.stages.mapping.config import MapConfig
from salpcc.stages.mapping.gather import gather
from salpcc.stages.mapping.tiles import Box, blocks_of

F64 = NDArray[np.float64]

VERSION = 3  # 2: de-skewed; 3: views know where returns are missing


@dataclass(frozen=True)
class Submap:
    """A gathered group, in the map's frame: its shards, and what the client must know to cut it.

    Attributes:
        boxes: what each block of the shard spans.
        viewed: places of its views.
    """

    entries: ShardRef
    views: ShardRef
    boxes: tuple[Box, ...]
    viewed: tuple[tuple[float, float, float], ...]
    points: int
    cpu_ms: float
    peak_mb: float


def gather_group(
    group: Group, poses: tuple[float, ...], motions: tuple[float, ...], config: MapConfig, out: Path
) -> Submap:
    """Decode a group of scans and gather it, unless its shards are there.

    Args:
        poses, motions: 16 and 6 numbers a scan, of the trajectory.

    Raises:
        ArchiveError: a payload is damaged; the message names the scan.
    """
    store = ShardStore(out)
    content = content_of(group, config)
    relevant = {
        k: v
        for k, v in config.model_dump().items()
        if k not in ("keep_movable", "fill", "refine_poses", "within", "carving")
    }
    digest = digest_of(VERSION, content, group.sequence, group.names, poses, motions, relevant)
    entries = store.ref(group.sequence, "submap", group.number, digest)
    views = store.ref(group.sequence, "views", group.number, digest)
    facts = store.found(entries) if store.found(views) is not None else None
    if facts is None:
        started = time.process_time()
        placed = np.array(poses).reshape(-1, 4, 4)
        submap = gather(scans_of(group, config, store), placed, np.array(motions).reshape(-1, 6), config)
        corner = whole_metres(placed[0, :3, 3])
        blocks = blocks_of(submap.voxels.xyz, config.tile)
        store.write(views, views_to_table(submap.views), {"stage": "views", "stage_version": VERSION})
        boxes = [Box.around(submap.voxels.xyz[part]) for _, part in blocks]
        facts = {
            "stage": "submap",
            "stage_version": VERSION,
            "corner": corner.tolist(),
            "boxes": [[box.low, box.high] for box in boxes],
            "viewed": [view.pose[:3, 3].tolist() for view in submap.views],
            "points": submap.points,
            "cpu_ms": 1e3 * (time.process_time() - started),
            "peak_mb": peak_mb(),
        }
        batches = [entries_to_batch(submap.voxels[part], corner) for _, part in blocks]
        write_blocks(store, entries, batches, ENTRIES, facts)
    return Submap(
        entries,
        views,
        tuple(Box(tuple(low), tuple(high)) for low, high in facts["boxes"]),
        tuple(tuple(place) for place in facts["viewed"]),
        facts["points"],
        facts["cpu_ms"],
        facts["peak_mb"],
    )
