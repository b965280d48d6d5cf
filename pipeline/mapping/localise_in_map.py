"""Localise scans in maps, as who drives in one does: the error of pose in each map, with movables and without."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import asdict, dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from salpcc.pipeline.decode import decode_scans
from salpcc.pipeline.mapping.map_frame import Frame
from salpcc.pipeline.mapping.map_poses import given_poses
from salpcc.pipeline.mapping.map_read import read_tile_file
from salpcc.pipeline.mapping.map_summary import frame_of_summary, read_summary
from salpcc.pipeline.schedule.cluster import connect
from salpcc.pipeline.schedule.flow import each
from salpcc.pipeline.schedule.lock import locked
from salpcc.pipeline.schedule.progress import bar
from salpcc.pipeline.schedule.store import ShardStore
from salpcc.schemas.errors import UsageError
from salpcc.schemas.work import ShardRef, digest_of
from salpcc.stages.evaluate.report import record
from salpcc.stages.evaluate.report.schema import LOCALISATION
from salpcc.stages.ingest.sources.frame_lines import frame_lines
from salpcc.stages.mapping.config import MapConfig
from salpcc.stages.mapping.drive.deskew import motions_of
from salpcc.stages.mapping.drive.registration import METHODS, rotation_error, translation_error
from salpcc.stages.mapping.gather import in_range, movable_of, still
from salpcc.stages.mapping.in_map import Surroundings
from salpcc.stages.mapping.tiles import Tile
from salpcc.stages.residual_code.archive.format import frame_number
from salpcc.stages.residual_code.archive.reader import ArchiveReader

F64 = NDArray[np.float64]

VERSION = 1


@dataclass(frozen=True)
class InMapRequest:
    """Which scans are localised in which maps.

    ``poses`` say where the scans are, as :func:`given_poses` takes them: None for those beside the first map. ``every`` takes
    every n-th scan.
    """

    archives: list[Path]
    maps: list[Path]
    out: Path
    poses: str | None = None
    every: int = 1
    workers: int | None = None
    scheduler: str | None = None
    quiet: bool = False


@dataclass(frozen=True)
class _Group:
    """One GOP of an archive: which of its scans are localised; poses of all, and where each begins, 16 numbers a scan, and motions, 6."""

    archive: str
    gop: int
    names: tuple[str, ...]
    chosen: tuple[bool, ...]
    poses: tuple[float, ...]
    starts: tuple[float, ...]
    motions: tuple[float, ...]

    def without(self, names: set[str]) -> _Group:
        """Return it with only those scans to localise that are not among ``names``."""
        chosen = zip(self.chosen, self.names, strict=True)
        return replace(self, chosen=tuple(wanted and name not in names for wanted, name in chosen))


def localise_in_maps(request: InMapRequest) -> pa.Table:
    """Localise scans in every map, each from where the scan before was; return the LOCALISATION table that is recorded.

    Scans that a map was made of fit themselves; they are taken only where there are no others.

    Raises:
        UsageError: no map there; maps of different frames.
        SourceError: poses that do not cover the scans.
    """
    summaries = [read_summary(path) for path in request.maps]
    frame = frame_of_summary(summaries[0])
    for path, summary in zip(request.maps, summaries, strict=True):
        if frame_of_summary(summary).crs != frame.crs:
            raise UsageError(f"{path}: not of the coordinate system of {request.maps[0]}")
    told = [
        digest_of(VERSION, s["inputs"], s["edits"], str(p))
        for s, p in zip(summaries, request.maps, strict=True)
    ]
    groups = [
        g
        for path in request.archives
        for g in _groups(path, request, frame, bool(summaries[0]["scans_moved_already"]))
    ]
    seen = {name for path in request.maps for name in frame_lines(path / "scans.txt")}
    new = [group.without(seen) for group in groups]
    known = not any(any(group.chosen) for group in new)
    groups = groups if known else [group for group in new if any(group.chosen)]
    reach = float(summaries[0]["config"]["max_range"])
    with ExitStack() as stack:
        stack.enter_context(locked(request.out))
        ShardStore(request.out).sweep()
        report = stack.enter_context(
            bar(sum(sum(g.chosen) for g in groups), "scans localised", request.quiet)
        )
        client = stack.enter_context(connect(request.workers, request.scheduler))
        if known:
            report.say(
                "all scans are of the maps, and fit what is there of themselves; map a part of the drive to localise the rest"
            )
        work = [(g, request.maps, told, frame, reach, request.out) for g in groups]
        what = [f"localise-{g.names[0]}" for g in groups]
        steps = [(sum(g.chosen), f"localised from {g.names[0]}") for g in groups]
        refs = each(client, localise_group, work, what, report, steps)
        table = ShardStore(request.out).together(refs, LOCALISATION)
    record.record(request.out, localisation=table)
    return table


def _groups(path: Path, request: InMapRequest, frame: Frame, moved_already: bool) -> list[_Group]:
    reader = ArchiveReader(path)
    poses = given_poses(request.poses or str(request.maps[0] / "poses.txt"), reader)
    poses[:, :3, 3] -= frame.origin
    names = reader.names
    numbers = [frame_number(name, place) for place, name in enumerate(names)]
    motions = np.zeros((len(names), 6)) if moved_already else motions_of(poses, numbers)
    starts = np.concatenate([poses[:1], poses[:-1]])
    groups, first = [], 0
    for gop, entries in enumerate(reader.gops):
        own = slice(first, first + len(entries))
        chosen = tuple(
            k > 0 and k % request.every == 0 and numbers[k] == numbers[k - 1] + 1
            for k in range(own.start, own.stop)
        )
        first = own.stop
        if any(chosen):
            numbers_of = (tuple(values[own].ravel().tolist()) for values in (poses, starts, motions))
            groups.append(_Group(str(path), gop, tuple(names[own]), chosen, *numbers_of))
    return groups


def localise_group(
    group: _Group, maps: list[Path], told: list[str], frame: Frame, reach: float, out: Path
) -> ShardRef:
    """Localise the scans of a group in every map, unless its shard is there; the shard is a LOCALISATION table.

    Args:
        told: a digest of each map.
        reach: metres to which scans are taken.

    Raises:
        ArchiveError: a payload is damaged; the message names the scan.
        UsageError: a map without tiles that can be read.
    """
    store, reader = ShardStore(out), ArchiveReader(Path(group.archive))
    sequence, config = reader.facts.sequence, reader.facts.config
    ref = store.ref(
        sequence,
        "localisation",
        group.gop,
        digest_of(VERSION, reader.facts.inputs, asdict(group), told, reach),
    )
    if store.found(ref) is not None:
        return ref
    poses, starts = (np.array(numbers).reshape(-1, 4, 4) for numbers in (group.poses, group.starts))
    motions = np.array(group.motions).reshape(-1, 6)
    around = [_surroundings(path, starts[:, :3, 3], frame, reach) for path in maps]
    taken = MapConfig.model_validate({"max_range": reach})
    rows: list[dict[str, Any]] = []
    for scan, wanted, pose, start, motion in zip(
        decode_scans(reader, group.gop), group.chosen, poses, starts, motions, strict=True
    ):
        if not wanted:
            continue
        near = in_range(scan.points, taken)
        points = still(scan, motion if scan.motion is None else np.zeros(6))
        movable = movable_of(scan)
        for with_movable in (True, False) if movable is not None else (True,):
            kept = near if with_movable or movable is None else near & ~movable
            for (path, surroundings), (title, method) in product(
                zip(maps, around, strict=True), METHODS.items()
            ):
                found = None if surroundings is None else surroundings.localise(points[kept], start, method)
                rows.append(
                    {
                        "sequence": sequence,
                        "scan": scan.name,
                        "map": path.name,
                        "max_error": config.get("max_error") or 0.0,
                        "movable": with_movable,
                        "method": title,
                        "rotation_deg": None if found is None else rotation_error(found, pose),
                        "translation_m": None if found is None else translation_error(found, pose),
                    }
                )
    store.write(
        ref,
        pa.Table.from_pylist(rows, schema=LOCALISATION),
        {"stage": "localisation", "stage_version": VERSION},
    )
    return ref


def _surroundings(path: Path, places: F64, frame: Frame, reach: float) -> Surroundings | None:
    """Read what a map has within reach of any of some places ``(n, 3)``, in the frame of the first map."""
    summary = read_summary(path)
    own, size = frame_of_summary(summary), float(summary["config"]["tile"])
    shift = np.array(own.origin) - np.array(frame.origin)
    parts = []
    for name in summary["tiles"]:
        if min(Tile.named(name).distance(place - shift, size) for place in places) < reach:
            parts.append(read_tile_file(path, name, own).xyz - np.array(frame.origin))
    return Surroundings.of(np.concatenate([np.empty((0, 3)), *parts]))
