"""What runs on a worker: one stage on one GOP. Only paths and small records come in and go out."""

from __future__ import annotations

import traceback
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import pyarrow as pa

from salpcc.pipeline.schedule.isolate import only, run_isolated
from salpcc.pipeline.schedule.machine import peak_mb
from salpcc.pipeline.schedule.stopwatch import Stopwatch
from salpcc.pipeline.schedule.store import ShardStore
from salpcc.schemas.config import RunConfig
from salpcc.schemas.errors import ShardError
from salpcc.schemas.files import unreachable
from salpcc.schemas.shards import facts_of
from salpcc.schemas.work import GopSource, Known, ScanError, ShardRef, digest_of
from salpcc.stages.coding import STAGES
from salpcc.stages.ingest.sources import SOURCES

_warm: set[str] = set()


@dataclass(frozen=True)
class GopResult:
    """What became of a GOP at one stage: its shards so far, or (``failed``) the reason in ``errors``.

    ``origin`` is the digest of its source, ``digest`` that of the stage's result; ``errors`` lists the
    scans lost on the way, ``learned`` the digests of files that were read for ``origin``.
    """

    origin: str
    digest: str
    shards: tuple[tuple[str, ShardRef], ...] = ()
    errors: tuple[ScanError, ...] = ()
    failed: bool = False
    learned: Known = field(default_factory=dict)


def source_digest(gop: GopSource, config: RunConfig) -> GopResult:
    """Digest all that decides what becomes of a GOP: the bytes of its files, the configuration, the code."""
    parts: list[Any] = [config.digest, {stage.name: stage.version for stage in STAGES.values()}]
    learned: Known = {}
    for ref in gop.scans:
        digests, more = SOURCES[gop.source].digest(ref, config.reads_labels(ref))
        parts.append([ref.name, ref.number, ref.time, *digests])
        learned |= more
    digest = digest_of(*parts)
    return GopResult(digest, digest, learned=learned)


def run_stage(
    stage: str, before: GopResult, gop: GopSource, config: RunConfig, out: Path, redo: bool
) -> GopResult:
    """Run one stage on one GOP, unless its shard is there already.

    A scan that breaks a kernel is left out, a GOP that breaks it is lost, and the reasons travel on in
    ``errors``; such shards are made again the next time. A disk that fails ends the run; the same command
    goes on from there.
    """
    if before.failed:
        return before
    store = ShardStore(out)
    digest = digest_of(before.digest, stage, STAGES[stage].version)
    ref = store.ref(gop.sequence, stage, gop.number, digest)
    facts = None if redo else store.found(ref)
    if facts is None or any(error["stage"] != "ingest" for error in facts["errors"]):
        try:
            table, facts = _work(
                stage, [store.read(dict(before.shards)[name]) for name in STAGES[stage].inputs], gop, config
            )
        except Exception as error:
            if isinstance(error, (OSError, ShardError)) or unreachable(error):
                raise
            return lost(stage, before, gop, error)
        store.write(
            ref,
            table,
            {"stage": stage, "stage_version": STAGES[stage].version, "config": config.digest, **facts},
        )
    errors = tuple(ScanError(**error) for error in facts["errors"])
    return replace(before, digest=digest, shards=(*before.shards, (stage, ref)), errors=errors)


def _work(
    stage: str, read: list[tuple[pa.Table, dict[str, Any]]], gop: GopSource, config: RunConfig
) -> tuple[pa.Table, dict[str, Any]]:
    """Run one stage; returns its table and the facts of the GOP so far: errors, times, peak memory."""
    facts: dict[str, Any] = read[-1][1] if read else {"errors": [], "times": [], "peak_mb": 0.0}
    errors = list(facts["errors"])
    if stage == "ingest":
        table, times = _timed(
            stage, lambda few: STAGES[stage].run(replace(gop, scans=gop.scans[: 1 if few else None]), config)
        )
        errors += facts_of(table.schema)["errors"]
        scans = table.num_rows
    else:
        dead = {error["scan"] for error in errors}
        alive = {scan.name for scan in gop.scans} - dead
        tables = only([table for table, _ in read], alive)
        scans = tables[0].num_rows
        guilty: dict[str, Exception] = {}

        def run(few: bool) -> pa.Table:
            if few:
                return STAGES[stage].run(*only(tables, set(tables[0].column("name").to_pylist()[:1])), config)
            result, found = run_isolated(lambda some: STAGES[stage].run(*some, config), tables)
            guilty.update(found)
            return result

        table, times = _timed(stage, run) if scans else (STAGES[stage].schema.empty_table(), (0.0, 0.0))
        errors += [vars(_error(stage, gop, name, error)) for name, error in guilty.items()]
    apart = facts_of(table.schema).get("apart", {}) if table.schema.metadata else {}
    spent = sum(apart.values())
    peak = peak_mb()
    return table, {
        "errors": errors,
        "times": [
            *facts["times"],
            [stage, scans, *(max(ms - spent, 0.0) for ms in times)],
            *([name, scans, ms, ms] for name, ms in apart.items()),
        ],
        "peak_mb": max(facts["peak_mb"], peak),
    }


def _timed(stage: str, run: Callable[[bool], pa.Table]) -> tuple[pa.Table, tuple[float, float]]:
    """Run ``run(False)``: its table, and CPU and wall milliseconds without what numba compiles and loads.

    The first time in a process, ``run(True)`` (one scan only) goes before for nothing, so that all else is loaded, too.
    """
    if stage not in _warm:
        _warm.add(stage)
        with suppress(Exception):  # the real run will say what is wrong
            run(True)
    with Stopwatch() as watch:
        table = run(False)
    return table, (watch.cpu_ms, watch.wall_ms)


def _error(stage: str, gop: GopSource, scan: str, error: Exception) -> ScanError:
    where = traceback.extract_tb(error.__traceback__)[-1]
    reason = f"{type(error).__name__}: {error} ({Path(where.filename).name}:{where.lineno})"
    return ScanError(gop.sequence, scan, stage, reason)


def lost(stage: str, before: GopResult, gop: GopSource, error: Exception) -> GopResult:
    """Turn an exception of a kernel into one error per scan that was still alive."""
    dead = {e.scan for e in before.errors}
    lost = tuple(_error(stage, gop, scan.name, error) for scan in gop.scans if scan.name not in dead)
    return replace(before, errors=(*before.errors, *lost), failed=True)
