"""A map from request to tiles: gather the groups, place them, build tiles, write what is one for the whole."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, nullcontext
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from distributed import Client

from salpcc.pipeline.cluster import connect
from salpcc.pipeline.flow import each
from salpcc.pipeline.lock import locked
from salpcc.pipeline.map_export import FORMATS, to_mcap
from salpcc.pipeline.map_plan import F64, ODOMETRY, Group, MapPlan, plan_map
from salpcc.pipeline.map_quality import labelled, quality_rows, tally_tile, truth_group
from salpcc.pipeline.map_tasks import Submap, TileResult, build_tile, chain, gather_group, parts_of, read_tile
from salpcc.pipeline.progress import Report, Silent, bar
from salpcc.pipeline.store import TOOL, ShardStore
from salpcc.schemas.errors import SourceError
from salpcc.schemas.files import atomic
from salpcc.schemas.work import digest_of
from salpcc.stages.evaluate import record
from salpcc.stages.evaluate.schema import MAP_QUALITY, PICTURES
from salpcc.stages.mapping.config import MapConfig
from salpcc.stages.mapping.picture import busiest, pictures
from salpcc.stages.mapping.score import Tally
from salpcc.stages.mapping.voxel import Voxels

VERSION = 1
_SAMPLE = 4_000_000  # entries at most that are drawn


@dataclass(frozen=True)
class MapRequest:
    """What a user asks for: the map, and where and how it is made.

    ``poses`` as in :func:`salpcc.pipeline.map_plan.plan_map`; ``against`` is a data root with labels to score by.
    """

    archives: list[Path]
    out: Path
    config: MapConfig = field(default_factory=MapConfig)
    poses: list[str] = field(default_factory=list)
    formats: list[str] = field(default_factory=lambda: list(FORMATS))
    against: Path | None = None
    workers: int | None = None
    scheduler: str | None = None
    keep_shards: bool = False
    quiet: bool = False
    command: str = ""


def make_map(request: MapRequest) -> dict[str, Any]:
    """Make a map; return what ``OUT/map.json`` holds. A map that is there, made of the same, is left as it is.

    Raises:
        UsageError, SourceError, ArchiveError: what is asked for cannot be; the message names file and scan.
        LockedError: another run is using the output folder.
    """
    plan = plan_map(request.archives, request.poses)
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
        client = stack.enter_context(connect(request.workers, request.scheduler))
        steps = (3 if refs is not None else 2) * plan.n_scans
        watch = nullcontext(Silent()) if request.quiet else bar(steps, client.dashboard_link)
        report: Report = stack.enter_context(watch)
        submaps = _gather(client, plan, request, report)
        places = _places(client, plan, submaps, request.out)
        tiles = _build(client, plan, submaps, places, request, report)
        scans = np.concatenate([pose @ s.placed() for s, pose in zip(submaps, places, strict=True)])
        cpu_s = 1e-3 * (sum(s.cpu_ms for s in submaps) + sum(t.cpu_ms for t in tiles))
        rows: list[dict[str, Any]] = []
        if refs is not None:
            groups = list(zip(plan.groups, refs, strict=True))
            tallies = _score(client, groups, scans, tiles, request, report)
            rows = quality_rows(tallies, plan, tiles, cpu_s)
        _write(request, plan, store, tiles, scans, rows)
        summary = {
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
            "pose_check": [asdict(s.agreement) for s in submaps if s.agreement is not None],
            "config": request.config.model_dump(mode="json"),
            "points_in": sum(s.points for s in submaps),
            "points_in_map": sum(t.points for t in tiles),
            "voxels": {k: sum(getattr(t, k) for t in tiles) for k in ("kept", "carved", "dropped", "filled")},
            "tiles": [t.tile.name for t in tiles if t.kept],
            "formats": request.formats,
            "cpu_ms_per_scan": {
                "gather": sum(s.cpu_ms for s in submaps) / plan.n_scans,
                "tiles": sum(t.cpu_ms for t in tiles) / plan.n_scans,
            },
            "wall_s": (datetime.now(UTC) - started).total_seconds(),
            "worker_peak_mb": round(max([s.peak_mb for s in submaps] + [t.peak_mb for t in tiles]), 1),
            "quality": rows,
        }
        with atomic(request.out / "map.json") as stream:
            stream.write(json.dumps(summary, indent=1).encode() + b"\n")
        if not request.keep_shards:
            for sequence in {plan.sequence, *(group.sequence for group in plan.groups)}:
                store.drop_sequence(sequence, ("submap", "views", "tile", "truth"))
    return summary


def _inputs(request: MapRequest, plan: MapPlan) -> str:
    """Digest all that decides what is written."""
    archives = []
    for path in request.archives:
        with open(path, "rb") as stream:
            archives.append(hashlib.file_digest(stream, "sha256").hexdigest())
    poses = [group.poses for group in plan.groups]
    return digest_of(
        VERSION, archives, poses, request.config.digest, sorted(request.formats), str(request.against)
    )


def _finished(request: MapRequest, inputs: str) -> dict[str, Any] | None:
    """Return the summary of a map that is complete and made of the same, or None."""
    try:
        summary: dict[str, Any] = json.loads((request.out / "map.json").read_text())
    except (OSError, ValueError):
        return None
    files = [
        request.out / "tiles" / f"{tile}.{form}"
        for tile in summary.get("tiles", [])
        for form in request.formats
        if form != "mcap"
    ]
    files += [request.out / "map.mcap"] if "mcap" in request.formats else []
    return summary if summary.get("inputs") == inputs and all(path.is_file() for path in files) else None


def _gather(client: Client, plan: MapPlan, request: MapRequest, report: Report) -> list[Submap]:
    """Gather all groups; given poses are watched as results come in, so that wrong ones end the job early."""
    found: dict[int, Submap] = {}
    work = [(group, request.config, request.out) for group in plan.groups]
    for at, submap in each(client, gather_group, work, [f"gather-{g.number:05d}" for g in plan.groups]):
        found[at] = submap
        group = plan.groups[at]
        report.advance(
            len(group.names), f"{group.sequence}: gathered scans {group.names[0]} to {group.names[-1]}"
        )
        _check_poses(plan, found, last=len(found) == len(work))
    return [found[at] for at in range(len(work))]


def _check_poses(plan: MapPlan, found: dict[int, Submap], last: bool) -> None:
    """Refuse poses that registration contradicts in most groups.

    Raises:
        SourceError: they are not the poses of these scans.
    """
    checked = [
        (plan.groups[at], s.agreement)
        for at, s in sorted(found.items())
        if s.agreement is not None and s.agreement.agree is not None
    ]
    wrong = [(group, a) for group, a in checked if not a.agree]
    if not wrong or 2 * len(wrong) <= len(checked) or (len(wrong) < 3 and not last):
        return
    group, a = wrong[0]
    raise SourceError(
        f"{plan.poses}: not the poses of these scans: from scan {group.names[0]} to {a.scan} of {group.archive} "
        f"registration finds {a.found_m:.2f} m driven, the poses say {a.given_m:.2f} m, {a.apart_m:.2f} m and "
        f"{a.apart_deg:.1f} degrees apart ({len(wrong)} of {len(checked)} groups disagree); name the poses of "
        f"sequence {group.sequence}, or use --poses {ODOMETRY}"
    )


def _places(client: Client, plan: MapPlan, submaps: list[Submap], out: Path) -> list[F64]:
    """Return the pose of each submap in the map: none where poses were given, else by registration."""
    if plan.groups[0].poses:
        return [np.eye(4)] * len(submaps)
    [(_, poses)] = each(client, chain, [(plan.groups, submaps, out)], ["chain"])
    return [np.array(pose).reshape(4, 4) for pose in poses]


def _build(
    client: Client,
    plan: MapPlan,
    submaps: list[Submap],
    places: list[F64],
    request: MapRequest,
    report: Report,
) -> list[TileResult]:
    """Build all tiles that anything lies in."""
    config, size = request.config, request.config.tile
    names = sorted(
        {
            t
            for s, pose in zip(submaps, places, strict=True)
            for b in s.boxes
            for t in b.moved(pose).tiles(size)
        }
    )
    work = [
        (tile, parts_of(tile, submaps, places, size), plan.sequence, config, request.formats, request.out)
        for tile in names
    ]
    found: dict[int, TileResult] = {}
    for at, result in each(client, build_tile, work, [f"tile-{tile.name}" for tile in names]):
        found[at] = result
        report.advance(_share(plan.n_scans, len(found), len(work)), f"{plan.sequence}: tile {names[at].name}")
    results = [found[at] for at in range(len(work))]
    _clear(request, {result.tile.name for result in results if result.kept})
    return results


def _score(
    client: Client,
    groups: Sequence[tuple[Group, Any]],
    scans: F64,
    tiles: list[TileResult],
    request: MapRequest,
    report: Report,
) -> dict[str, Tally]:
    """Tally the map against the labels of its source."""
    work, at = [], 0
    for group, refs in groups:
        poses = tuple(scans[at : at + len(refs)].ravel().tolist())
        work.append((group, refs, poses, request.config, request.out))
        at += len(refs)
    truths: dict[int, Any] = {}
    for place, truth in each(client, truth_group, work, [f"truth-{g.number:05d}" for g, _ in groups]):
        truths[place] = truth
        report.advance(len(groups[place][0].names), f"{groups[place][0].sequence}: labels read")
    ordered = [truths[place] for place in range(len(work))]
    jobs = [
        (
            t.tile,
            t.ref,
            [truth for truth in ordered if (t.tile.x, t.tile.y) in truth.tiles],
            request.config,
            request.out,
        )
        for t in tiles
    ]
    total: dict[str, Tally] = {}
    for _, counts in each(client, tally_tile, jobs, [f"tally-{t.tile.name}" for t in tiles]):
        total = {name: total.get(name, Tally()) + count for name, count in counts.items()}
    return total


def _write(
    request: MapRequest,
    plan: MapPlan,
    store: ShardStore,
    tiles: list[TileResult],
    scans: F64,
    rows: list[dict[str, Any]],
) -> None:
    """Write what is one for the whole map: the MCAP, the scans' poses, pictures and records for the report."""
    lines = [" ".join(f"{value:.9e}" for value in pose[:3].ravel()) for pose in scans]
    names = [name for group in plan.groups for name in group.names]
    with atomic(request.out / "poses.txt") as stream:
        stream.write(("\n".join(lines) + "\n").encode())
    with atomic(request.out / "scans.txt") as stream:
        stream.write(("\n".join(names) + "\n").encode())
    if "mcap" in request.formats:
        to_mcap(_kept(store, tiles), request.out / "map.mcap")
    else:
        (request.out / "map.mcap").unlink(missing_ok=True)
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
            voxels, against = read_tile(store, tile.ref)
            yield voxels[against == 0]


def _sample(store: ShardStore, tiles: list[TileResult]) -> tuple[Voxels, Any]:
    """Take evenly spaced entries of all tiles, as many as can be drawn."""
    total = sum(t.kept + t.carved_or_dropped for t in tiles)
    every = max(1, -(-total // _SAMPLE))
    parts, fates = [], [np.empty(0, np.uint8)]
    for tile in tiles:
        if tile.ref is not None:
            voxels, against = read_tile(store, tile.ref)
            parts.append(voxels[::every])
            fates.append(against[::every])
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


def _clear(request: MapRequest, names: set[str]) -> None:
    """Delete tiles of an older map in the same folder."""
    wanted = {f"{name}.{form}" for name in names for form in request.formats} | {f".{n}" for n in names}
    for path in (request.out / "tiles").glob("*"):
        if path.name not in wanted:
            path.unlink()


def _share(total: int, done: int, of: int) -> int:
    """Steps of a bar over ``total`` for the ``done``-th of ``of`` pieces, so that all together are ``total``."""
    return total * done // of - total * (done - 1) // of
