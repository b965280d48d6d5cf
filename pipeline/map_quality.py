"""Score a map against the labels of its source, tile by tile."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa

from salpcc.pipeline.map_plan import F64, Group, MapPlan
from salpcc.pipeline.map_store import batches_to_truth, read_blocks, truth_to_batch
from salpcc.pipeline.map_tasks import TileResult, read_tile
from salpcc.pipeline.plan import missing_root
from salpcc.pipeline.store import ShardStore
from salpcc.schemas.errors import SourceError, UsageError
from salpcc.schemas.work import ScanRef, ShardRef, digest_of
from salpcc.stages.ingest.sources import SOURCES
from salpcc.stages.ingest.sources.velodyne_bin import read_points
from salpcc.stages.mapping.build import CARVED, DROPPED
from salpcc.stages.mapping.config import MapConfig
from salpcc.stages.mapping.poses import move
from salpcc.stages.mapping.score import Tally, Truth, quality, tally, truth_of_labels
from salpcc.stages.mapping.tiles import Tile, blocks_of
from salpcc.stages.mapping.voxel import keys_of
from salpcc.stages.residual_code.archive_reader import ArchiveReader

VERSION = 2
# A row of the table: its name, and the bits that keep an entry out of that map.
CLEANERS = {
    "none": 0,
    "ours, carving only": CARVED,
    "ours, classes only": DROPPED,
    "ours": CARVED | DROPPED,
}


@dataclass(frozen=True)
class TruthRef:
    """The labelled points of a group, by tile."""

    ref: ShardRef
    tiles: tuple[tuple[int, int], ...]


def labelled(plan: MapPlan, root: Path) -> list[tuple[ScanRef, ...]]:
    """Find the source scans, with labels, of every group.

    Raises:
        UsageError: no such root, or archives that were not made from files.
        SourceError: a scan or its labels are not there.
    """
    found: list[tuple[ScanRef, ...]] = []
    by_archive: dict[str, dict[str, ScanRef]] = {}
    for group in plan.groups:
        if group.archive not in by_archive:
            source = ArchiveReader(group.archive).facts.source
            if source not in SOURCES:
                raise UsageError(f"{group.archive}: made from {source}, there are no labels to compare with")
            if not root.is_dir():
                raise UsageError(missing_root(root, source))
            by_archive[group.archive] = {r.name: r for r in SOURCES[source].scans(root, group.sequence)}
        refs = by_archive[group.archive]
        for name in group.names:
            if name not in refs or refs[name].labels is None:
                raise SourceError(f"{root}: scan {name} of sequence {group.sequence} has no labels there")
        found.append(tuple(refs[name] for name in group.names))
    return found


def truth_group(
    group: Group, refs: Sequence[ScanRef], poses: tuple[float, ...], config: MapConfig, out: Path
) -> TruthRef:
    """Place the labelled points of a group's source scans and count them by voxel."""
    store = ShardStore(out)
    digest = digest_of(
        VERSION, group.sequence, group.names, [r.path for r in refs], poses, config.model_dump(mode="json")
    )
    ref = store.ref(group.sequence, "truth", group.number, digest)
    if not store.has(ref):
        places = np.array(poses).reshape(-1, 4, 4)
        truth = []
        for scan, pose in zip(refs, places, strict=True):
            truth.append(_truth_of(scan, pose, config))
        tiles, batches = [], []
        whole = _joined(truth)
        for tile, part in blocks_of(whole[0], config.tile):
            counts = Truth.of_points(whole[0][part], whole[1][part], config.voxel)
            if len(counts.keys):
                tiles.append((tile.x, tile.y))
                batches.append(truth_to_batch(counts))
        empty = truth_to_batch(Truth.together([]))
        table = pa.Table.from_batches(batches, schema=empty.schema)
        store.write(ref, table, {"stage": "truth", "stage_version": VERSION, "tiles": tiles})
    return TruthRef(ref, tuple((x, y) for x, y in store.facts(ref)["tiles"]))


def tally_tile(
    tile: Tile, built: ShardRef | None, truths: Sequence[TruthRef], config: MapConfig, out: Path
) -> dict[str, Tally]:
    """Count what of a tile's truth is in each of the maps that :data:`CLEANERS` names."""
    store = ShardStore(out)
    batches = []
    for truth in truths:
        at = [i for i, place in enumerate(truth.tiles) if place == (tile.x, tile.y)]
        batches += read_blocks(store, truth.ref, at)
    counted = batches_to_truth(batches)
    keys, against = np.empty(0, np.int64), np.empty(0, np.uint8)
    if built is not None:
        voxels, against = read_tile(store, built)
        keys = keys_of(voxels.xyz, config.voxel)
    return {name: tally(counted, keys[against & bits == 0], config.voxel) for name, bits in CLEANERS.items()}


def quality_rows(
    tallies: dict[str, Tally], plan: MapPlan, tiles: Sequence[TileResult], seconds: float
) -> list[dict[str, object]]:
    """Return the rows of the map table, one per cleaner and kind of truth."""
    sizes = {
        "none": sum(t.kept + t.carved_or_dropped - t.filled for t in tiles),
        "ours": sum(t.kept - t.filled for t in tiles),
    }
    rows: list[dict[str, object]] = []
    for name, counts in tallies.items():
        for truth, figures in quality(counts).items():
            rows.append(
                {
                    "sequence": plan.sequence,
                    "scans": plan.n_scans,
                    "cleaner": name,
                    "cloud": "decoded",
                    "truth": truth,
                    **{key.lower(): value for key, value in figures.items()},
                    "points": sizes.get(name),
                    "seconds": seconds if name == "ours" else None,
                }
            )
    return rows


def _truth_of(scan: ScanRef, pose: F64, config: MapConfig) -> tuple[F64, np.ndarray]:
    points, _ = read_points(Path(scan.path))
    assert scan.labels is not None
    labels = np.fromfile(scan.labels, "<u4")
    if len(labels) != len(points):
        raise SourceError(f"{scan.labels}: {len(labels)} labels for {len(points)} points")
    square = np.square(points.astype(np.float64)).sum(axis=1)
    near = (square >= config.min_range**2) & (square <= config.max_range**2)
    return move(points[near], pose), truth_of_labels(labels[near])


def _joined(parts: Sequence[tuple[F64, np.ndarray]]) -> tuple[F64, np.ndarray]:
    return np.concatenate([p for p, _ in parts]), np.concatenate([t for _, t in parts])
