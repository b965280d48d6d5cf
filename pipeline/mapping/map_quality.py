"""Score a map against the labels of its source, tile by tile."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from salpcc.pipeline.mapping.map_plan import F64, Group, MapPlan
from salpcc.pipeline.mapping.map_store import (
    TRUTH,
    batches_to_truth,
    read_blocks,
    truth_to_batch,
    write_blocks,
)
from salpcc.pipeline.mapping.map_tiles import TileResult, read_tile
from salpcc.pipeline.plan.plan import check_original
from salpcc.pipeline.schedule.store import ShardStore
from salpcc.schemas.errors import SourceError
from salpcc.schemas.scan import Scan
from salpcc.schemas.work import ScanRef, ShardRef, digest_of
from salpcc.stages.ingest.sources import SOURCES
from salpcc.stages.ingest.sources.velodyne_bin import read_points
from salpcc.stages.mapping.build import CARVED, DROPPED, OBJECT
from salpcc.stages.mapping.cleaners import cleaner
from salpcc.stages.mapping.config import MapConfig
from salpcc.stages.mapping.drive.poses import move
from salpcc.stages.mapping.gather import in_range, still
from salpcc.stages.mapping.score import Tally, Truth, quality, tally, truth_of_labels
from salpcc.stages.mapping.tiles import Box, Tile, blocks_of
from salpcc.stages.mapping.voxel import keys_of
from salpcc.stages.residual_code.archive.reader import ArchiveReader

VERSION = 3
CLASSES_ONLY = "ours, classes only"
# A row of the table: its name, and the bits that keep an entry out of that map.
CLEANERS = {
    "none": 0,
    "ours, carving only": CARVED,
    CLASSES_ONLY: DROPPED,
    "ours": CARVED | DROPPED | OBJECT,
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
            check_original(group.archive, source, root)
            by_archive[group.archive] = {r.name: r for r in SOURCES[source].scans(root, group.sequence)}
        refs = by_archive[group.archive]
        for name in group.names:
            if name not in refs or refs[name].labels is None:
                raise SourceError(f"{root}: scan {name} of sequence {group.sequence} has no labels there")
        found.append(tuple(refs[name] for name in group.names))
    return found


def truth_group(
    group: Group,
    refs: Sequence[ScanRef],
    poses: tuple[float, ...],
    motions: tuple[float, ...],
    config: MapConfig,
    within: Box | None,
    out: Path,
) -> TruthRef:
    """De-skew and place the labelled points of a group's source scans and count them by voxel, within a box of the map's frame."""
    store = ShardStore(out)
    digest = digest_of(
        VERSION,
        group.sequence,
        group.names,
        [r.path for r in refs],
        poses,
        motions,
        config.model_dump(mode="json"),
        within and asdict(within),
    )
    ref = store.ref(group.sequence, "truth", group.number, digest)
    facts = store.found(ref)
    if facts is None:
        truth = [
            _truth_of(scan, pose, motion, config) for scan, pose, motion in _placed(refs, poses, motions)
        ]
        tiles, batches = [], []
        whole = _joined(truth)
        if within is not None:
            inside = within.holds(whole[0])
            whole = whole[0][inside], whole[1][inside]
        for tile, part in blocks_of(whole[0], config.tile):
            counts = Truth.of_points(whole[0][part], whole[1][part], config.voxel)
            if len(counts.keys):
                tiles.append((tile.x, tile.y))
                batches.append(truth_to_batch(counts))
        facts = {"stage": "truth", "stage_version": VERSION, "tiles": tiles}
        write_blocks(store, ref, batches, TRUTH, facts)
    return TruthRef(ref, tuple((x, y) for x, y in facts["tiles"]))


def tally_tile(
    tile: Tile, built: ShardRef | None, truths: Sequence[TruthRef], config: MapConfig, out: Path
) -> dict[str, Tally]:
    """Count what of a tile's truth is in each of the maps that :data:`CLEANERS` names."""
    store = ShardStore(out)
    batches = []
    for truth in truths:
        at = [i for i, place in enumerate(truth.tiles) if place == (tile.x, tile.y)]
        batches += read_blocks(store, truth.ref, at)[0]
    counted = batches_to_truth(batches)
    keys, against = np.empty(0, np.int64), np.empty(0, np.uint8)
    if built is not None:
        tiled = read_tile(store, built)
        keys, against = keys_of(tiled.voxels.xyz, config.voxel), tiled.against
    return {name: tally(counted, keys[against & bits == 0], config.voxel) for name, bits in CLEANERS.items()}


def rival_tally(
    name: str,
    refs: Sequence[ScanRef],
    poses: tuple[float, ...],
    motions: tuple[float, ...],
    truths: Sequence[TruthRef],
    config: MapConfig,
    out: Path,
) -> tuple[Tally, int, float]:
    """Clean the source scans by a public cleaner and count what is left, with its voxels and CPU seconds.

    It sees the same points at the same poses, all of them at once, and no labels.
    """
    scans = []
    for ref, pose, motion in _placed(refs, poses, motions):
        points, near = _still(ref, motion, config)
        scans.append((points[near].astype(np.float32), pose))
    started = time.process_time()
    masks = cleaner(name)(scans)
    seconds = time.process_time() - started
    kept = [
        np.unique(keys_of(move(points[mask], pose), config.voxel))
        for (points, pose), mask in zip(scans, masks, strict=True)
    ]
    keys = np.unique(np.concatenate(kept))
    store = ShardStore(out)
    batches = [b for t in truths for b in read_blocks(store, t.ref, range(len(t.tiles)))[0]]
    return tally(batches_to_truth(batches), keys, config.voxel), len(keys), seconds


def rival_rows(plan: MapPlan, found: dict[str, tuple[Tally, int, float]]) -> list[dict[str, object]]:
    """Return the rows of public cleaners for the map table."""
    return [
        _row(plan, name, "source", truth, figures, points, seconds)
        for name, (counts, points, seconds) in found.items()
        for truth, figures in quality(counts).items()
    ]


def quality_rows(
    tallies: dict[str, Tally], plan: MapPlan, tiles: Sequence[TileResult], seconds: float
) -> list[dict[str, object]]:
    """Return the rows of the map table, one per cleaner and kind of truth."""
    sizes = {
        "none": sum(t.kept + t.carved_or_dropped - t.filled for t in tiles),
        "ours": sum(t.kept - t.filled for t in tiles),
    }
    return [
        _row(plan, name, "decoded", truth, figures, sizes.get(name), seconds if name == "ours" else None)
        for name, counts in tallies.items()
        for truth, figures in quality(counts).items()
    ]


def _row(
    plan: MapPlan,
    cleaner: str,
    cloud: str,
    truth: str,
    figures: dict[str, float | None],
    points: int | None,
    seconds: float | None,
) -> dict[str, object]:
    head = {
        "sequence": plan.sequence,
        "scans": plan.n_scans,
        "cleaner": cleaner,
        "cloud": cloud,
        "truth": truth,
    }
    return {**head, **{k.lower(): v for k, v in figures.items()}, "points": points, "seconds": seconds}


def _placed(
    refs: Sequence[ScanRef], poses: tuple[float, ...], motions: tuple[float, ...]
) -> Iterator[tuple[ScanRef, F64, F64]]:
    yield from zip(refs, np.array(poses).reshape(-1, 4, 4), np.array(motions).reshape(-1, 6), strict=True)


def _still(ref: ScanRef, motion: F64, config: MapConfig) -> tuple[F64, NDArray[np.bool_]]:
    """The points ``(N, 3)`` of a source scan, de-skewed as the map's are, and which of them a map takes."""
    points, intensity = read_points(Path(ref.path))
    return still(Scan(ref.name, points, intensity), motion), in_range(points, config)


def _truth_of(ref: ScanRef, pose: F64, motion: F64, config: MapConfig) -> tuple[F64, NDArray[np.uint8]]:
    points, near = _still(ref, motion, config)
    assert ref.labels is not None
    labels = np.fromfile(ref.labels, "<u4")
    if len(labels) != len(points):
        raise SourceError(
            f"{ref.labels}: {len(labels)} labels for {len(points)} points; name the root of these scans with --against"
        )
    return move(points[near], pose), truth_of_labels(labels)[near]


def _joined(parts: Sequence[tuple[F64, NDArray[np.uint8]]]) -> tuple[F64, NDArray[np.uint8]]:
    return np.concatenate([p for p, _ in parts]), np.concatenate([t for _, t in parts])
