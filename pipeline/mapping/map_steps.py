"""The steps of a map over a cluster: find where the scans stand, gather them, build all tiles, score the whole."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from distributed import Client

from salpcc.pipeline.mapping.map_frame import frame_of
from salpcc.pipeline.mapping.map_plan import ODOMETRY, Group, MapPlan
from salpcc.pipeline.mapping.map_quality import (
    TruthRef,
    quality_rows,
    rival_rows,
    rival_tally,
    tally_tile,
    truth_group,
)
from salpcc.pipeline.mapping.map_request import MapRequest
from salpcc.pipeline.mapping.map_submaps import Submap, gather_group
from salpcc.pipeline.mapping.map_tiles import TileResult, build_tile, parts_of
from salpcc.pipeline.mapping.map_track import Prepared, Track, prepare_group, read_track, track
from salpcc.pipeline.mapping.map_tune import read_trials, tune_stretch
from salpcc.pipeline.mapping.map_write import clear
from salpcc.pipeline.schedule.flow import each
from salpcc.pipeline.schedule.progress import Report
from salpcc.schemas.errors import SourceError, UsageError
from salpcc.schemas.work import ScanRef
from salpcc.stages.mapping.drive.agree import Agreement
from salpcc.stages.mapping.drive.deskew import fastest, motions_of
from salpcc.stages.mapping.drive.refine import PoseCheck
from salpcc.stages.mapping.score import Tally
from salpcc.stages.mapping.tune import STRETCH, Trial

_TURN = 5.0  # metres that a scan is moved by at most when it is de-skewed


@dataclass(frozen=True)
class MapSteps:
    """One map in the making: who works on it, what is planned and asked for, and who is told how far it is."""

    client: Client
    plan: MapPlan
    request: MapRequest
    report: Report

    def track(self) -> tuple[Track, float]:
        """Find where all scans stand, and say how well given poses fit; return it, and the CPU milliseconds that it took.

        Raises:
            SourceError: given poses are not the poses of these scans; or registration loses the way.
        """
        plan, request = self.plan, self.request
        work = [(group, request.config, request.out) for group in plan.groups]
        names = [f"prepare-{g.number:05d}" for g in plan.groups]
        prepared: list[Prepared] = each(
            self.client, prepare_group, work, names, self.report, _steps(plan.groups, "read scans")
        )
        whole = (plan.groups, prepared, request.config.refine_poses, request.out)
        [ref] = each(self.client, track, [whole], ["track"])
        found = read_track(request.out, ref)
        _refuse_foreign(plan, found.agreements)
        if found.moved_already:
            self.report.say(
                "scans: they fit one another better as they are than de-skewed, so their driver moved them already"
            )
        if found.agreements:
            self.report.say(told(found.check))
        return found, sum(p.cpu_ms for p in prepared) + found.cpu_ms

    def tune(self, found: Track) -> list[Trial]:
        """Try settings of the carving on the stretch where one drove farthest; return them, the best first."""
        plan, request = self.plan, self.request
        part = fastest(
            motions_of(found.poses, [number for group in plan.groups for number in group.numbers]), STRETCH
        )
        ends = np.cumsum([len(group.names) for group in plan.groups])
        names = [name for group in plan.groups for name in group.names]
        groups = [
            g
            for g, end in zip(plan.groups, ends, strict=True)
            if end > part.start and end - len(g.names) < part.stop
        ]
        work = (groups, frozenset(names[part]), *found.of(part), request.config, request.out)
        self.report.say(
            f"{plan.sequence}: tuned on scans {names[part][0]} to {names[part][-1]}, with movers pasted into them"
        )
        [ref] = each(self.client, tune_stretch, [work], ["tune"])
        return read_trials(request.out, ref)

    def gather(self, found: Track) -> list[Submap]:
        """Gather all groups that see anything of what is to be made.

        Raises:
            UsageError: none does.
        """
        plan, request = self.plan, self.request
        chosen = list(self._near(found))
        if not chosen:
            raise UsageError(_nowhere(plan, found, request))
        self.report.advance(
            plan.n_scans - sum(len(group.names) for group, _ in chosen), f"{plan.sequence}: placed"
        )
        work = [(group, *found.of(own), request.config, request.out) for group, own in chosen]
        names = [f"gather-{group.number:05d}" for group, _ in chosen]
        steps = _steps([group for group, _ in chosen], "gathered scans")
        return each(self.client, gather_group, work, names, self.report, steps)

    def build(self, submaps: list[Submap]) -> list[TileResult]:
        """Build all tiles that anything lies in."""
        plan, request = self.plan, self.request
        config, size = request.config, request.config.tile
        names = sorted({tile for submap in submaps for box in submap.boxes for tile in box.tiles(size)})
        within = config.box(plan.origin)
        if within is not None:
            names = [tile for tile in names if within.touches(tile, size)]
        facts = (
            plan.sequence,
            config,
            request.formats,
            frame_of(plan.origin, request.archives[0], request.crs),
            request.out,
        )
        work = [(tile, parts_of(tile, submaps, size), *facts) for tile in names]
        steps = [
            (_share(plan.n_scans, at, len(work)), f"{plan.sequence}: tile {tile.name}")
            for at, tile in enumerate(names, start=1)
        ]
        what = [f"tile-{tile.name}" for tile in names]
        results: list[TileResult] = each(self.client, build_tile, work, what, self.report, steps)
        clear(request, {result.tile.name for result in results if result.kept})
        return results

    def score(
        self, refs: Sequence[Sequence[ScanRef]], found: Track, tiles: list[TileResult], cpu_s: float
    ) -> list[dict[str, Any]]:
        """Tally the map, and those of public cleaners, against the labels of the source; return the table's rows."""
        plan, request = self.plan, self.request
        box = request.config.box(plan.origin)
        chosen = list(self._near(found))
        work = [
            (group, refs[group.number], *found.of(own), request.config, box, request.out)
            for group, own in chosen
        ]
        names = [f"truth-{g.number:05d}" for g, _ in chosen]
        steps = _steps([group for group, _ in chosen], "read labels of scans")
        truths: list[TruthRef] = each(self.client, truth_group, work, names, self.report, steps)
        jobs = [
            (
                t.tile,
                t.ref,
                [truth for truth in truths if (t.tile.x, t.tile.y) in truth.tiles],
                request.config,
                request.out,
            )
            for t in tiles
        ]
        total: dict[str, Tally] = {}
        for counts in each(self.client, tally_tile, jobs, [f"tally-{t.tile.name}" for t in tiles]):
            total = {name: total.get(name, Tally()) + tally for name, tally in counts.items()}
        every = [ref for group, _ in chosen for ref in refs[group.number]]
        whole = found.of(np.concatenate([np.r_[own] for _, own in chosen]))
        rivals = [(name, every, *whole, truths, request.config, request.out) for name in request.rivals]
        beside = dict(
            zip(request.rivals, each(self.client, rival_tally, rivals, request.rivals), strict=True)
        )
        return quality_rows(total, plan, tiles, cpu_s) + rival_rows(plan, beside)

    def _near(self, found: Track) -> Iterator[tuple[Group, slice]]:
        """Choose the groups of which a scan reaches what is to be made, each with its place in the trajectory."""
        plan, request = self.plan, self.request
        box, at = request.config.box(plan.origin), 0
        for group in plan.groups:
            own = slice(at, at + len(group.names))
            at = own.stop
            if box is None or box.distance(found.poses[own, :3, 3]).min() <= request.config.max_range + _TURN:
                yield group, own


def told(check: PoseCheck) -> str:
    """Say in a line how well given poses fit, and what was done about it."""
    if (
        check.apart_m is None
        or check.given_residual_m is None
        or check.residual_m is None
        or check.scale is None
    ):
        return "poses: too few points fit to check them"
    fit = (
        f"poses: {100 * check.apart_m:.0f} cm and {check.apart_deg:.2f} degrees from what registration finds over a group of scans, "
        f"way {100 * (check.scale - 1):+.1f} %; points lie {100 * check.given_residual_m:.1f} cm off the surfaces of other scans"
    )
    if not check.refined:
        return f"{fit}; taken as they are"
    return (
        f"{fit}, {100 * check.residual_m:.1f} cm with refined poses, which are taken and written to poses.txt"
    )


def _refuse_foreign(plan: MapPlan, agreements: Sequence[Agreement]) -> None:
    checked = [a for a in agreements if a.agree is not None]
    wrong = [a for a in checked if not a.agree]
    if not wrong or 2 * len(wrong) <= len(checked):
        return
    a = wrong[0]
    group = next(group for group in plan.groups if group.names[-1] == a.scan)
    raise SourceError(
        f"{plan.poses}: not the poses of these scans: from scan {group.names[0]} to {a.scan} of {group.archive} "
        f"registration finds {a.found_m:.2f} m driven, the poses say {a.given_m:.2f} m, {a.apart_m:.2f} m and "
        f"{a.apart_deg:.1f} degrees apart ({len(wrong)} of {len(checked)} groups disagree); name the poses of "
        f"sequence {group.sequence}, or use --poses {ODOMETRY}"
    )


def _nowhere(plan: MapPlan, found: Track, request: MapRequest) -> str:
    places = found.poses[:, :3, 3] + plan.origin
    low, high = (
        ",".join(f"{value:.1f}" for value in corner) for corner in (places.min(axis=0), places.max(axis=0))
    )
    wanted = ",".join(f"{value:g}" for value in request.config.within or ())
    return (
        f"--within {wanted}: no scan came within {request.config.max_range:g} m of it; the drive is in {low},{high} "
        "(metres, in the frame of the poses)"
    )


def _steps(groups: Sequence[Group], doing: str) -> list[tuple[int, str]]:
    """What a bar is told of each group."""
    return [(len(g.names), f"{g.sequence}: {doing} {g.names[0]} to {g.names[-1]}") for g in groups]


def _share(total: int, done: int, of: int) -> int:
    """Steps of a bar over ``total`` for the ``done``-th of ``of`` pieces, so that all together are ``total``."""
    return total * done // of - total * (done - 1) // of
