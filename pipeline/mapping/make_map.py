"""A map from request to tiles, resumable: what is there already is not made again."""

from __future__ import annotations

import hashlib
from contextlib import ExitStack
from dataclasses import asdict, replace
from datetime import UTC, datetime
from typing import Any

import pyarrow as pa

from salpcc.pipeline.export.las import coordinate_system
from salpcc.pipeline.mapping.map_explain import drop_older, keep
from salpcc.pipeline.mapping.map_export import tile_file
from salpcc.pipeline.mapping.map_frame import frame_of
from salpcc.pipeline.mapping.map_plan import MapPlan, plan_map
from salpcc.pipeline.mapping.map_quality import CLASSES_ONLY, labelled
from salpcc.pipeline.mapping.map_request import MapRequest
from salpcc.pipeline.mapping.map_scans import unclassified
from salpcc.pipeline.mapping.map_steps import MapSteps
from salpcc.pipeline.mapping.map_submaps import Submap
from salpcc.pipeline.mapping.map_summary import (
    explained_to_json,
    figures_of_map,
    frame_to_json,
    read_summary,
    write_summary,
)
from salpcc.pipeline.mapping.map_tiles import TileResult
from salpcc.pipeline.mapping.map_track import Track
from salpcc.pipeline.mapping.map_tune import trials_to_json
from salpcc.pipeline.mapping.map_write import Whole, check_place, write_track, write_whole
from salpcc.pipeline.schedule.cluster import connect
from salpcc.pipeline.schedule.lock import locked
from salpcc.pipeline.schedule.progress import bar
from salpcc.pipeline.schedule.store import ShardStore
from salpcc.schemas.errors import UsageError
from salpcc.schemas.version import TOOL
from salpcc.schemas.work import digest_of
from salpcc.stages.evaluate.report.record import record
from salpcc.stages.evaluate.report.schema import MAP_QUALITY
from salpcc.stages.mapping.cleaners import cleaner
from salpcc.stages.mapping.tune import best
from salpcc.stages.residual_code.archive.reader import ArchiveReader

VERSION = 5  # 2: LAZ of one unit of intensity; 3: de-skewed, poses refined; 4: carving weighs what was met; 5: edits
NO_CLASSES = "no classes in it, so nothing tells what is movable; encode it without --keep-movable, or with --labels given"
ASK = "ask the network with --labels network"


def make_map(request: MapRequest) -> dict[str, Any]:
    """Make a map; return what ``OUT/map.json`` holds. A map that is there, made of the same, is left as it is.

    Raises:
        UsageError, SourceError, ArchiveError: what is asked for cannot be; the message names file and scan. Or the folder holds
            files of others that a map has, too.
        LockedError: another run is using the output folder.
    """
    check_place(request.out)
    plan = plan_map(request.archives, request.poses)
    if request.crs:
        coordinate_system(request.crs)
    for name in request.rivals:
        cleaner(name)
    refs = labelled(plan, request.against) if request.against is not None else None
    inputs = _inputs(request, plan)
    started = datetime.now(UTC)
    with ExitStack() as stack:
        stack.enter_context(locked(request.out))
        done = _finished(request, inputs)
        if done is not None:
            return done
        store = ShardStore(request.out)
        store.sweep()
        passes = 4 if refs is not None else 3
        report = stack.enter_context(bar(passes * plan.n_scans, "scans read, placed or built", request.quiet))
        client = stack.enter_context(connect(request.workers, request.scheduler))
        untold = _untold(request)
        if untold:
            report.say(f"{', '.join(untold)}: {NO_CLASSES}, or {ASK}")
        unread = _unread(request)
        if unread and request.explain:
            report.say(
                f"{', '.join(unread)}: what may move has a layer that is not read; --layers all explains that, too"
            )
        making = MapSteps(client, plan, request, report)
        found, track_ms = making.track()
        trials = making.tune(found) if request.tune else []
        if trials:
            chosen = best(trials, request.config.carving)
            request = replace(request, config=request.config.model_copy(update={"carving": chosen}))
            making = replace(making, request=request)
        submaps = making.gather(found)
        tiles = making.build(submaps)
        cpu_s = 1e-3 * (track_ms + sum(s.cpu_ms for s in submaps) + sum(t.cpu_ms for t in tiles))
        rows: list[dict[str, Any]] = []
        if refs is not None:
            rows = making.score(refs, found, tiles, cpu_s)
            if len(untold) == len(request.archives):  # they dropped nothing: that was not measured
                rows = [row for row in rows if row["cleaner"] != CLASSES_ONLY]
        frame = frame_of(plan.origin, request.archives[0], request.crs)
        size = request.config.tile
        if request.explain:
            tiles = keep(store, plan.sequence, tiles, size)
        write_track(request.out, plan, found.poses)
        whole = Whole(plan.sequence, plan.n_scans, tuple(request.formats), size, frame, request.explain)
        write_whole(request.out, whole, store, tiles, found.poses)
        if rows:
            record(request.out, map_quality=pa.Table.from_pylist(rows, schema=MAP_QUALITY))
        summary = _summary(request, plan, inputs, started, found, track_ms, submaps, tiles)
        summary |= frame_to_json(frame) | figures_of_map(tiles)
        summary |= {"explained": explained_to_json(tiles) if request.explain else [], "edits": []}
        summary |= {"quality": rows, "archives_without_classes": untold, "tuning": trials_to_json(trials)}
        for edit in _edits(request):
            report.say(f"the map that was here had been edited, this one is not: {edit['command']}")
        write_summary(request.out, summary)
        drop_older(store, plan.sequence, tiles if request.explain else [])
        if not request.keep_shards:
            for sequence in {plan.sequence, *(group.sequence for group in plan.groups)}:
                store.drop_sequence(
                    sequence, ("classes", "thinned", "track", "tuning", "submap", "views", "tile", "truth")
                )
    return summary


def _edits(request: MapRequest) -> list[dict[str, Any]]:
    """What was edited of the map that is there."""
    try:
        return list(read_summary(request.out).get("edits", []))
    except UsageError:
        return []


def _unread(request: MapRequest) -> list[str]:
    """The archives of which a layer is left out."""
    if request.config.keep_movable or request.config.layers == "all":
        return []
    return [str(path) for path in request.archives if ArchiveReader(path).movable == "layered"]


def _untold(request: MapRequest) -> list[str]:
    """The archives that do not say what is movable, where that is to be taken out."""
    if request.config.keep_movable or request.config.labels == "network":
        return []
    return [str(path) for path in request.archives if unclassified(ArchiveReader(path))]


def _summary(
    request: MapRequest,
    plan: MapPlan,
    inputs: str,
    started: datetime,
    found: Track,
    track_ms: float,
    submaps: list[Submap],
    tiles: list[TileResult],
) -> dict[str, Any]:
    """Say how the map was made, of what, and at what cost."""
    return {
        "version": VERSION,
        "tool": TOOL,
        "command": request.command,
        "started": started.isoformat(timespec="seconds"),
        "finished": datetime.now(UTC).isoformat(timespec="seconds"),
        "inputs": inputs,
        "archives": [str(path) for path in request.archives],
        "sequence": plan.sequence,
        "scans": plan.n_scans,
        "poses": plan.poses,
        "pose_fit": asdict(found.check),
        "scans_moved_already": found.moved_already,
        "pose_check": [asdict(a) for a in found.agreements],
        "config": request.config.model_dump(mode="json"),
        "points_in": sum(s.points for s in submaps),
        "formats": request.formats,
        "cpu_ms_per_scan": {
            "track": track_ms / plan.n_scans,
            "gather": sum(s.cpu_ms for s in submaps) / plan.n_scans,
            "tiles": sum(t.cpu_ms for t in tiles) / plan.n_scans,
        },
        "wall_s": (datetime.now(UTC) - started).total_seconds(),
        "worker_peak_mb": round(max([s.peak_mb for s in submaps] + [t.peak_mb for t in tiles]), 1),
    }


def _inputs(request: MapRequest, plan: MapPlan) -> str:
    """Digest all that decides what is written."""
    archives = []
    for path in request.archives:
        with open(path, "rb") as stream:
            archives.append(hashlib.file_digest(stream, "sha256").hexdigest())
    poses = [group.poses for group in plan.groups]
    return digest_of(
        VERSION,
        archives,
        poses,
        request.config.digest,
        sorted(request.formats),
        str(request.against),
        sorted(request.rivals),
        request.crs,
        request.explain,
        request.tune,
    )


def _finished(request: MapRequest, inputs: str) -> dict[str, Any] | None:
    """Return the summary of a map that is complete and made of the same, or None."""
    try:
        summary = read_summary(request.out)
    except UsageError:
        return None
    files = [
        tile_file(request.out, tile, form)
        for tile in summary.get("tiles", [])
        for form in request.formats
        if form != "mcap"
    ]
    files += [request.out / "map.mcap"] if "mcap" in request.formats else []
    files += [request.out / "shards" / tile["ref"]["path"] for tile in summary.get("explained", [])]
    return summary if summary.get("inputs") == inputs and all(path.is_file() for path in files) else None
