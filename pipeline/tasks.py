"""What runs on a worker: one stage on one GOP. Only paths and small records come in and go out."""

from __future__ import annotations

import hashlib
import resource
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pyarrow as pa

from salpcc.pipeline.store import ShardStore
from salpcc.schemas.config import RunConfig
from salpcc.schemas.shards import OF_STAGE, facts_of
from salpcc.schemas.work import STAGES, GopSource, ScanError, ShardRef, digest_of
from salpcc.stages.evaluate import stage as evaluate
from salpcc.stages.ground_fit import stage as ground_fit
from salpcc.stages.ingest import stage as ingest
from salpcc.stages.predict import stage as predict
from salpcc.stages.residual_code import stage as residual_code
from salpcc.stages.segment import stage as segment

VERSIONS: dict[str, int] = {
    "ingest": ingest.VERSION,
    "segment": segment.VERSION,
    "ground_fit": ground_fit.VERSION,
    "predict": predict.VERSION,
    "residual_code": residual_code.VERSION,
    "evaluate": evaluate.VERSION,
}
# What each stage takes besides the configuration; ingest takes the GOP itself.
INPUTS: dict[str, tuple[str, ...]] = {
    "ingest": (),
    "segment": ("ingest",),
    "ground_fit": ("segment",),
    "predict": ("segment", "ground_fit"),
    "residual_code": ("segment", "ground_fit", "predict"),
}
RUN: dict[str, Callable[..., pa.Table]] = {
    "ingest": ingest.run,
    "segment": segment.run,
    "ground_fit": ground_fit.run,
    "predict": predict.run,
    "residual_code": residual_code.run,
}
_warm: set[tuple[str, str]] = set()


@dataclass(frozen=True)
class GopResult:
    """What became of a GOP at one stage: its shards so far, or (``failed``) the reason in ``errors``.

    ``origin`` is the digest of its source, ``digest`` that of the stage's result; ``errors`` lists the
    scans lost on the way.
    """

    origin: str
    digest: str
    shards: tuple[tuple[str, ShardRef], ...] = ()
    errors: tuple[ScanError, ...] = ()
    failed: bool = False


def source_digest(gop: GopSource, config: RunConfig) -> GopResult:
    """Digest all that decides what becomes of a GOP: the bytes of its files, the configuration, the code."""
    parts: list[Any] = [config.digest, {stage: VERSIONS[stage] for stage in STAGES[:-1]}]
    for ref in gop.scans:
        files = [ref.path, ref.labels] if config.labels == "given" else [ref.path]
        parts.append([ref.name, ref.number, ref.time, *(file_digest(file) for file in files)])
    digest = digest_of(*parts)
    return GopResult(digest, digest)


def file_digest(path: str | None) -> str:
    """SHA-256 of a file, or a word for why there is none."""
    if path is None:
        return "absent"
    try:
        with open(path, "rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError as error:  # it will fail in ingest too, and be done again once it is readable
        return f"unreadable: {error.errno}"


def run_stage(
    stage: str, before: GopResult, gop: GopSource, config: RunConfig, out: Path, redo: bool
) -> GopResult:
    """Run one stage on one GOP, unless its shard is there already.

    A kernel that fails loses this GOP, not the run: the reason travels on in ``errors``. A disk that
    fails ends the run; the same command goes on from there.
    """
    if before.failed:
        return before
    store = ShardStore(out)
    digest = digest_of(before.digest, stage, VERSIONS[stage])
    ref = store.ref(gop.sequence, stage, gop.number, digest)
    if store.has(ref) and not redo:
        facts: dict[str, Any] = store.facts(ref)
    else:
        shards = dict(before.shards)
        read = [store.read(shards[name]) for name in INPUTS[stage]]
        inputs: list[Any] = [table for table, _ in read] or [gop]
        facts = dict(read[-1][1]) if read else {"errors": [], "times": [], "peak_mb": 0.0}
        try:
            table, times = _timed(stage, inputs, config)
        except Exception as error:  # noqa: BLE001
            return lost(stage, before, gop, error)
        if not read:
            facts["errors"] = facts_of(table.schema)["errors"]
        store.write(
            ref,
            table,
            {
                "stage": stage,
                "stage_version": VERSIONS[stage],
                "config": config.digest,
                "errors": facts["errors"],
                "times": [
                    *facts["times"],
                    [stage, table.num_rows if stage == "ingest" else inputs[0].num_rows, *times],
                ],
                "peak_mb": max(facts["peak_mb"], resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024),
            },
        )
    errors = tuple(ScanError(**error) for error in facts["errors"])
    return replace(before, digest=digest, shards=(*before.shards, (stage, ref)), errors=errors)


def _timed(stage: str, inputs: list[Any], config: RunConfig) -> tuple[pa.Table, tuple[float, float]]:
    """Run a stage's kernels; CPU and wall milliseconds exclude the compilation of numba functions."""
    if stage != "ingest" and inputs[0].num_rows == 0:
        return OF_STAGE[stage].empty_table(), (0.0, 0.0)
    if (stage, config.digest) not in _warm:
        _warm_up(stage, inputs, config)
        _warm.add((stage, config.digest))
    cpu, wall = time.process_time(), time.perf_counter()
    table = RUN[stage](*inputs, config)
    return table, (1e3 * (time.process_time() - cpu), 1e3 * (time.perf_counter() - wall))


def _warm_up(stage: str, inputs: list[Any], config: RunConfig) -> None:
    """Run the first two scans for nothing, so that numba has compiled what the clock should not see."""
    first = inputs[0]
    few = replace(first, scans=first.scans[:2]) if stage == "ingest" else first.slice(0, 2)
    try:
        RUN[stage](few, *inputs[1:], config)
    except Exception:  # noqa: BLE001 (the real run will say what is wrong)
        return


def lost(stage: str, before: GopResult, gop: GopSource, error: Exception) -> GopResult:
    """Turn an exception of a kernel into one error per scan that was still alive."""
    where = traceback.extract_tb(error.__traceback__)[-1]
    reason = f"{type(error).__name__}: {error} ({Path(where.filename).name}:{where.lineno})"
    dead = {e.scan for e in before.errors}
    lost = tuple(ScanError(gop.sequence, s.name, stage, reason) for s in gop.scans if s.name not in dead)
    return replace(before, errors=(*before.errors, *lost), failed=True)
