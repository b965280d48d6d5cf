"""The steps of a map over a cluster: gather all groups, place them, build all tiles, score the whole."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from distributed import Client

from salpcc.pipeline.flow import each
from salpcc.pipeline.mapping.map_frame import frame_of
from salpcc.pipeline.mapping.map_plan import F64, ODOMETRY, Group, MapPlan
from salpcc.pipeline.mapping.map_quality import (
    TruthRef,
    quality_rows,
    rival_rows,
    rival_tally,
    tally_tile,
    truth_group,
)
from salpcc.pipeline.mapping.map_request import MapRequest
from salpcc.pipeline.mapping.map_submaps import Submap, chain, gather_group
from salpcc.pipeline.mapping.map_tiles import TileResult, build_tile, parts_of
from salpcc.pipeline.mapping.map_write import clear
from salpcc.pipeline.progress import Report
from salpcc.schemas.errors import SourceError
from salpcc.stages.mapping.score import Tally


def gather_all(client: Client, plan: MapPlan, request: MapRequest, report: Report) -> list[Submap]:
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


def place_all(client: Client, plan: MapPlan, submaps: list[Submap], out: Path) -> list[F64]:
    """Return the pose of each submap in the map: none where poses were given, else by registration."""
    if plan.groups[0].poses:
        return [np.eye(4)] * len(submaps)
    [(_, poses)] = each(client, chain, [(plan.groups, submaps, out)], ["chain"])
    return [np.array(pose).reshape(4, 4) for pose in poses]


def build_all(
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
    facts = (
        plan.sequence,
        config,
        request.formats,
        frame_of(plan.origin, request.archives[0], request.crs),
        request.out,
    )
    work = [(tile, parts_of(tile, submaps, places, size), *facts) for tile in names]
    found: dict[int, TileResult] = {}
    for at, result in each(client, build_tile, work, [f"tile-{tile.name}" for tile in names]):
        found[at] = result
        report.advance(_share(plan.n_scans, len(found), len(work)), f"{plan.sequence}: tile {names[at].name}")
    results = [found[at] for at in range(len(work))]
    clear(request, {result.tile.name for result in results if result.kept})
    return results


def score_all(
    client: Client,
    plan: MapPlan,
    groups: Sequence[tuple[Group, Any]],
    scans: F64,
    tiles: list[TileResult],
    request: MapRequest,
    report: Report,
    cpu_s: float,
) -> list[dict[str, Any]]:
    """Tally the map, and those of public cleaners, against the labels of the source; return the table's rows."""
    work, at = [], 0
    for group, refs in groups:
        poses = tuple(scans[at : at + len(refs)].ravel().tolist())
        work.append((group, refs, poses, request.config, request.out))
        at += len(refs)
    truths: dict[int, TruthRef] = {}
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
    every, poses = [ref for _, refs in groups for ref in refs], tuple(scans.ravel().tolist())
    rivals = [(name, every, poses, ordered, request.config, request.out) for name in request.rivals]
    found = {request.rivals[at]: result for at, result in each(client, rival_tally, rivals, request.rivals)}
    return quality_rows(total, plan, tiles, cpu_s) + rival_rows(plan, found)


def _share(total: int, done: int, of: int) -> int:
    """Steps of a bar over ``total`` for the ``done``-th of ``of`` pieces, so that all together are ``total``."""
    return total * done // of - total * (done - 1) // of
