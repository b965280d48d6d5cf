"""Where the scans of a map stand: what of each is registered, and the trajectory of the whole drive."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import lru_cache, partial
from pathlib import Path

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from salpcc.pipeline.mapping.map_plan import Group
from salpcc.pipeline.mapping.map_scans import content_of, scans_of
from salpcc.pipeline.schedule.machine import peak_mb
from salpcc.pipeline.schedule.store import ShardStore
from salpcc.schemas.errors import SourceError
from salpcc.schemas.scan import Scan
from salpcc.schemas.work import ShardRef, digest_of
from salpcc.stages.mapping.config import MapConfig
from salpcc.stages.mapping.drive.agree import Agreement, agreement
from salpcc.stages.mapping.drive.deskew import motions_of, turns_before
from salpcc.stages.mapping.drive.moved_already import moved_already, still
from salpcc.stages.mapping.drive.odometry import Registered, Thinned, follow, thin
from salpcc.stages.mapping.drive.refine import PoseCheck, candidates, choose, residual, spots_of
from salpcc.stages.mapping.gather import standing

F64 = NDArray[np.float64]

VERSION = 2  # 2: scans that were moved already are left alone
_THINNED = pa.schema([*((name, pa.float32()) for name in ("x", "y", "z", "before"))])
_TRACK = pa.schema([("pose", pa.list_(pa.float64())), ("motion", pa.list_(pa.float64()))])
_GROUPS_HELD = 8  # of thinned scans, while a residual is measured


@dataclass(frozen=True)
class Prepared:
    """A group whose scans were thinned to be registered."""

    ref: ShardRef
    cpu_ms: float
    peak_mb: float


@dataclass(frozen=True, eq=False)
class Track:
    """The trajectory of a drive.

    Attributes:
        poses: ``(n, 4, 4)`` of all scans, in the map's frame.
        motions: ``(n, 6)`` by which each is de-skewed; zeros where it was compensated.
        check: how well given poses fit, and the ones here.
        agreements: of given poses with registration, a group each; none without given poses.
        moved_already: whether scans that tell no motion turned out to be compensated all the same.
    """

    poses: F64
    motions: F64
    check: PoseCheck
    agreements: tuple[Agreement, ...]
    moved_already: bool
    cpu_ms: float

    def of(self, scans: slice | NDArray[np.intp]) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Return poses and motions of some scans as plain numbers, 16 and 6 a scan."""
        return tuple(self.poses[scans].ravel().tolist()), tuple(self.motions[scans].ravel().tolist())


def prepare_group(group: Group, config: MapConfig, out: Path) -> Prepared:
    """Decode a group of scans and thin what stands still of them, unless its shard is there.

    Raises:
        ArchiveError: a payload is damaged; the message names the scan.
    """
    store = ShardStore(out)
    content = content_of(group, config)
    reach = (config.min_range, config.max_range)
    digest = digest_of(VERSION, content, group.sequence, group.names, group.numbers, reach)
    ref = store.ref(group.sequence, "thinned", group.number, digest)
    facts = store.found(ref)
    if facts is None:
        started = time.process_time()
        columns, sizes, motions = [], [], []
        for scan in scans_of(group, config, store):
            columns.append(_thinned(scan, config))
            sizes.append(len(columns[-1]))
            motions.append(None if scan.motion is None else scan.motion.tolist())
        rows = np.concatenate(columns)
        table = pa.table([pa.array(column) for column in rows.T.copy()], schema=_THINNED)
        facts = {
            "stage": "thinned",
            "stage_version": VERSION,
            "sizes": sizes,
            "motions": motions,
            "cpu_ms": 1e3 * (time.process_time() - started),
            "peak_mb": peak_mb(),
        }
        store.write(ref, table, facts)
    return Prepared(ref, facts["cpu_ms"], facts["peak_mb"])


def _thinned(scan: Scan, config: MapConfig) -> NDArray[np.float32]:
    kept = standing(scan, config)
    points, before = thin(scan.points[kept], turns_before(scan)[kept])
    return np.column_stack([points, before])


def track(groups: Sequence[Group], prepared: Sequence[Prepared], refine: bool, out: Path) -> ShardRef:
    """Find the trajectory of the drive, unless its shard is there: registered, or given poses that are checked and refined.

    Raises:
        SourceError: without given poses, a scan does not register to those before it.
    """
    store = ShardStore(out)
    given = np.concatenate([group.given() for group in groups]) if groups[0].poses else None
    digest = digest_of(
        VERSION,
        [p.ref.digest for p in prepared],
        refine,
        None if given is None else [group.poses for group in groups],
    )
    ref = store.ref(groups[0].sequence, "track", 0, digest)
    if store.found(ref) is not None:
        return ref
    started = time.process_time()
    clouds = [
        cloud for group, p in zip(groups, prepared, strict=True) for cloud in _headings(group, p, store)
    ]
    found = list(follow((read(store) for read in clouds), given))
    reads = [partial(cloud, store) for cloud in clouds]
    moved = moved_already(reads, found, [cloud.number for cloud in clouds])
    if moved:
        clouds = [replace(cloud, still=True) for cloud in clouds]
        found = list(follow((read(store) for read in clouds), given))
    if given is None:
        _refuse_gaps(groups, found)
    poses, motions, check, agreements = _settled(store, groups, clouds, found, given, refine)
    compensated = [cloud.still or cloud.motion is not None for cloud in clouds]
    motions[compensated] = 0.0
    table = pa.table([[pose.ravel() for pose in poses], list(motions)], schema=_TRACK)
    facts = {
        "check": asdict(check),
        "agreements": [asdict(a) for a in agreements],
        "moved_already": moved,
        "cpu_ms": 1e3 * (time.process_time() - started),
    }
    store.write(ref, table, {"stage": "track", "stage_version": VERSION, **facts})
    return ref


def read_track(out: Path, ref: ShardRef) -> Track:
    """Read what :func:`track` found."""
    table, facts = ShardStore(out).read(ref)
    return Track(
        np.array(table.column("pose").to_pylist()).reshape(-1, 4, 4),
        np.array(table.column("motion").to_pylist()).reshape(-1, 6),
        PoseCheck(**facts["check"]),
        tuple(Agreement(**a) for a in facts["agreements"]),
        facts["moved_already"],
        facts["cpu_ms"],
    )


def _settled(
    store: ShardStore,
    groups: Sequence[Group],
    clouds: Sequence[_Heading],
    found: list[Registered],
    given: F64 | None,
    refine: bool,
) -> tuple[F64, F64, PoseCheck, list[Agreement]]:
    """Choose the trajectory that the map is made with; return it, its motions, and what was found of the given one."""
    numbers = [cloud.number for cloud in clouds]
    spots = spots_of(len(clouds))

    def cloud_at(place: int) -> Thinned:
        return clouds[place](store)

    def judged(poses: F64) -> float | None:
        return residual(cloud_at, spots, poses, motions_of(poses, numbers))

    seen = np.array([f.pose for f in found])
    if given is None:
        check = PoseCheck(None, judged(seen), None, None, None, False)
        return seen, motions_of(seen, numbers), check, []
    agreements, at = [], 0
    for group in groups:
        own = slice(at, at + len(group.names))
        if len(group.names) > 1:
            agreements.append(agreement(group.names[-1], given[own], found[own]))
        at = own.stop
    ways, scale = candidates(seen, given)
    residuals = {name: judged(poses) for name, poses in (ways.items() if refine else [("given", given)])}
    name = choose(residuals)
    check = PoseCheck(
        residuals["given"],
        residuals[name],
        scale,
        float(np.median([a.apart_m for a in agreements])) if agreements else None,
        float(np.median([a.apart_deg for a in agreements])) if agreements else None,
        name != "given",
    )
    return ways[name], motions_of(ways[name], numbers), check, agreements


def _refuse_gaps(groups: Sequence[Group], found: list[Registered]) -> None:
    names = [(group.archive, name) for group in groups for name in group.names]
    for (archive, name), scan in zip(names, found, strict=True):
        if not scan.good:
            raise SourceError(
                f"{archive}: scan {name} does not register to the scans before it ({scan.overlap:.0%} of its points fit): "
                "a gap, or another drive; give --poses FILE, or map the parts one by one"
            )


@dataclass(frozen=True)
class _Heading:
    """Where a thinned scan lies: its shard, rows, number and own motion, and whether it is de-skewed. Called, it reads it."""

    ref: ShardRef
    rows: slice
    number: int
    motion: tuple[float, ...] | None
    still: bool = False

    def __call__(self, store: ShardStore) -> Thinned:
        values = _rows_of(store.root.parent, self.ref)[self.rows]
        motion = None if self.motion is None else np.array(self.motion)
        cloud = Thinned(self.number, values[:, :3].copy(), values[:, 3].copy(), motion)
        return still(cloud) if self.still else cloud


@lru_cache(maxsize=_GROUPS_HELD)
def _rows_of(out: Path, ref: ShardRef) -> NDArray[np.float32]:
    table, _ = ShardStore(out).read(ref)
    return np.column_stack([np.array(table.column(name)) for name in _THINNED.names])


def _headings(group: Group, prepared: Prepared, store: ShardStore) -> Iterator[_Heading]:
    facts = store.facts(prepared.ref)
    ends = np.cumsum(facts["sizes"]).tolist()
    for number, size, end, motion in zip(group.numbers, facts["sizes"], ends, facts["motions"], strict=True):
        yield _Heading(
            prepared.ref, slice(end - size, end), number, None if motion is None else tuple(motion)
        )
