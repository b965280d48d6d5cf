"""Submaps on a worker: gather a group of scans, register groups one to the other."""

from __future__ import annotations

import time
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from salpcc.pipeline.archive import Layers, decode_scans
from salpcc.pipeline.machine import peak_mb
from salpcc.pipeline.mapping.map_plan import Group
from salpcc.pipeline.mapping.map_store import (
    ENTRIES,
    batch_to_entries,
    entries_to_batch,
    views_to_table,
    whole_metres,
    write_blocks,
)
from salpcc.pipeline.store import ShardStore
from salpcc.schemas.errors import SourceError
from salpcc.schemas.scan import Scan
from salpcc.schemas.work import ShardRef, digest_of
from salpcc.stages.mapping.agree import Agreement, agreement
from salpcc.stages.mapping.config import MapConfig
from salpcc.stages.mapping.gather import gather
from salpcc.stages.mapping.odometry import LocalMap, start_of
from salpcc.stages.mapping.poses import inverse
from salpcc.stages.mapping.tiles import Box, blocks_of
from salpcc.stages.residual_code.archive.reader import ArchiveReader

F64 = NDArray[np.float64]

VERSION = 1


@dataclass(frozen=True)
class Submap:
    """A gathered group: its shards, and what the client must know to place and cut it.

    Attributes:
        boxes: what each block of the shard spans, in the submap's frame.
        poses: 16 numbers a scan, in the submap's frame.
        viewed: places of its views, in the submap's frame.
        motion: of its first scan, or empty.
        agreement: of the given poses with registration, where that was asked.
    """

    entries: ShardRef
    views: ShardRef
    boxes: tuple[Box, ...]
    poses: tuple[float, ...]
    viewed: tuple[tuple[float, float, float], ...]
    motion: tuple[float, ...]
    points: int
    cpu_ms: float
    peak_mb: float
    agreement: Agreement | None

    def placed(self) -> F64:
        """Return the poses ``(n, 4, 4)``."""
        return np.array(self.poses).reshape(-1, 4, 4)


def gather_group(group: Group, config: MapConfig, out: Path) -> Submap:
    """Decode a group of scans and gather it, unless its shards are there.

    Raises:
        ArchiveError: a payload is damaged; the message names the scan.
        SourceError: a scan does not register to those before it.
    """
    store = ShardStore(out)
    reader = ArchiveReader(group.archive)
    layers: Layers = "static" if reader.movable == "layered" and not config.keep_movable else "all"
    payloads = reader.payloads(group.gop)
    if layers == "all":
        payloads += reader.movable_payloads(group.gop)
    content = [zlib.crc32(payload.data) for payload in payloads]
    relevant = {k: v for k, v in config.model_dump().items() if k not in ("keep_movable", "fill")}
    parts = (VERSION, content, group.sequence, group.names, group.numbers, group.poses, group.check, relevant)
    digest = digest_of(*parts)
    entries = store.ref(group.sequence, "submap", group.number, digest)
    views = store.ref(group.sequence, "views", group.number, digest)
    if not (store.has(entries) and store.has(views)):
        _gather(group, config, store, entries, views, reader, layers)
    facts = store.facts(entries)
    checked = facts["agreement"]
    return Submap(
        entries,
        views,
        tuple(Box(tuple(low), tuple(high)) for low, high in facts["boxes"]),
        tuple(facts["poses"]),
        tuple(tuple(place) for place in facts["viewed"]),
        tuple(facts["motion"]),
        facts["points"],
        facts["cpu_ms"],
        facts["peak_mb"],
        None if checked is None else Agreement(**checked),
    )


def _gather(
    group: Group,
    config: MapConfig,
    store: ShardStore,
    entries: ShardRef,
    views: ShardRef,
    reader: ArchiveReader,
    layers: Layers,
) -> None:
    started = time.process_time()
    given = group.given()
    first_motion: list[float] = []

    def scans() -> Iterator[Scan]:
        for scan in decode_scans(reader, group.gop, layers):
            if not first_motion and scan.motion is not None and scan.name == group.names[0]:
                first_motion.extend(scan.motion.tolist())
            yield scan

    submap = gather(scans(), group.numbers, given, config, group.check)
    if given is None:
        for name, found in zip(group.names, submap.found, strict=True):
            if not found.good:
                raise lost_track(group.archive, name, found.overlap)
    checked = agreement(group.names[-1], given, submap.found) if given is not None and group.check else None
    corner = whole_metres(submap.poses[0, :3, 3])
    blocks = blocks_of(submap.voxels.xyz, config.tile)
    store.write(views, views_to_table(submap.views), {"stage": "views", "stage_version": VERSION})
    boxes = [Box.around(submap.voxels.xyz[part]) for _, part in blocks]
    facts = {
        "corner": corner.tolist(),
        "boxes": [[box.low, box.high] for box in boxes],
        "poses": submap.poses.ravel().tolist(),
        "viewed": [view.pose[:3, 3].tolist() for view in submap.views],
        "motion": first_motion,
        "points": submap.points,
        "cpu_ms": 1e3 * (time.process_time() - started),
        "peak_mb": peak_mb(),
        "agreement": None if checked is None else asdict(checked),
    }
    batches = [entries_to_batch(submap.voxels[part], corner) for _, part in blocks]
    write_blocks(store, entries, batches, ENTRIES, {"stage": "submap", "stage_version": VERSION, **facts})


def lost_track(archive: str, name: str, overlap: float) -> SourceError:
    """The error of a scan that odometry cannot place."""
    return SourceError(
        f"{archive}: scan {name} does not register to the scans before it ({overlap:.0%} of its points fit): "
        "a gap, or another drive; give --poses FILE, or map the parts one by one"
    )


def chain(groups: Sequence[Group], submaps: Sequence[Submap], out: Path) -> list[tuple[float, ...]]:
    """Register submaps found by odometry one to the other; return the pose of each in the first one's frame.

    Raises:
        SourceError: a group does not register to those before it.
    """
    store = ShardStore(out)
    target = LocalMap()
    poses: list[F64] = []
    for at, (group, submap) in enumerate(zip(groups, submaps, strict=True)):
        guess = np.eye(4)
        if at:
            before, turns = submaps[at - 1].placed(), group.numbers[0] - groups[at - 1].numbers[-1]
            step = start_of(np.array(submap.motion), turns) if submap.motion and turns > 0 else None
            if step is None:
                step = inverse(before[-2]) @ before[-1] if len(before) > 1 else np.eye(4)
            guess = poses[-1] @ before[-1] @ step
        table, facts = store.read(submap.entries)
        voxels = batch_to_entries(table, facts["corner"])
        found = target.register(voxels.xyz[~voxels.movable], guess)
        if not found.good:
            raise lost_track(group.archive, group.names[0], found.overlap)
        poses.append(found.pose)
    return [tuple(pose.ravel().tolist()) for pose in poses]
