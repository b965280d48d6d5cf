"""A run from request to report: plan the work, hold the output, run the graph, gather what it measured."""

from __future__ import annotations

import json
from contextlib import AbstractContextManager, ExitStack
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pyarrow as pa

from salpcc.pipeline.encode import resolve
from salpcc.pipeline.find.catalogue import catalogue_of, write_catalogue
from salpcc.pipeline.graph.graph import Graph, GraphOptions, Outcome
from salpcc.pipeline.graph.sequence import archive_path
from salpcc.pipeline.held_poses import held_poses
from salpcc.pipeline.plan.plan import SequencePlan, plan_run
from salpcc.pipeline.schedule.cluster import check_device, connect
from salpcc.pipeline.schedule.lock import locked
from salpcc.pipeline.schedule.progress import STDERR, Report, bar
from salpcc.pipeline.schedule.store import ShardStore
from salpcc.schemas.config import UNBOUNDED, RunConfig
from salpcc.schemas.errors import UsageError
from salpcc.schemas.files import is_url, write_json
from salpcc.schemas.version import TOOL
from salpcc.schemas.work import ScanError
from salpcc.stages.evaluate.report import record
from salpcc.stages.evaluate.report import write as report
from salpcc.stages.evaluate.report.schema import BASELINES, FAILURES, METRICS, TIMES
from salpcc.stages.ingest.sources.simulated import Simulated
from salpcc.stages.residual_code.archive.reader import ArchiveReader


@dataclass(frozen=True)
class RunRequest:
    """What a user asks for: the configuration, and where and how it runs.

    ``root`` None is only good for the simulated source, which then keeps its scans in the output.
    """

    config: RunConfig
    sequences: list[str]
    out: Path
    root: Path | None = None
    workers: int | None = None
    scheduler: str | None = None
    graph: GraphOptions = field(default_factory=GraphOptions)
    quiet: bool = False
    command: str = ""


@dataclass
class RunResult:
    """What a run gives: the content of report.json (None before ``evaluate``), and the scans that failed."""

    report: dict[str, Any] | None
    errors: list[ScanError] = field(default_factory=list)

    @property
    def failed(self) -> bool:
        """Tell whether anything was lost."""
        return bool(self.errors)


def run_sequences(request: RunRequest) -> RunResult:
    """Run the pipeline over sequences.

    Raises:
        UsageError: the root or all sequences are missing, an option makes no sense.
        LockedError: another run is using the output folder.
        SalpccError: something that is nobody's scan failed, such as the disk.
    """
    # Workers may run on other machines, in other current folders.
    request = replace(request, out=request.out.absolute())
    config = resolve(request.config)
    root = request.root.absolute() if request.root is not None else request.out / "simulated"
    _check_urls(request, root)
    _check_place(request.out)
    started = datetime.now(UTC)
    with ExitStack() as stack:
        if config.source != "simulated":
            plans, missing = plan_run(root, request.sequences, config, request.out)
            stack.enter_context(locked(request.out))
        else:
            stack.enter_context(locked(request.out))
            _simulate(root, request.sequences, config, request.quiet)
            plans, missing = plan_run(root, request.sequences, config, request.out)
        ShardStore(request.out).sweep()
        watcher = stack.enter_context(_watch(request, plans))
        client = stack.enter_context(connect(request.workers, request.scheduler))
        check_device(client, config.device)
        watcher.say(f"dashboard {client.dashboard_link}")
        for error in missing:
            watcher.say(error.reason)
        outcomes = Graph(client, config, request.out, request.graph, watcher).run(plans)
        write_json(request.out / "config.json", config.model_dump(mode="json"))
    errors = missing + [error for outcome in outcomes for error in outcome.errors]
    if not request.graph.reaches("evaluate"):
        return RunResult(None, errors)
    _gather(request, config, root, outcomes, errors, started)
    return RunResult(report.build(request.out), errors)


def _check_place(out: Path) -> None:
    """Refuse a folder that has a config.json of something else, of which a run has one, too."""
    path = out / "config.json"
    try:
        told = json.loads(path.read_bytes())
    except OSError:  # not there; whether it can be written shows
        return
    except ValueError:
        told = None
    if not (isinstance(told, dict) and "profile" in told):
        raise UsageError(f"{path}: of no run, and one would replace it; name another folder with --out")


def _check_urls(request: RunRequest, root: Path) -> None:
    """Refuse what cannot be done with a URL."""
    if request.config.source == "simulated" and is_url(root):
        raise UsageError(
            f"{root}: simulated scans are written to a folder of this machine; name one with --root"
        )
    if request.workers != 0 and any(str(path).startswith("memory://") for path in (root, request.out)):
        raise UsageError("memory:// lives in one process: --workers 0")


def _simulate(root: Path, sequences: list[str], config: RunConfig, quiet: bool) -> None:
    """Make the simulated sequences that are not there; ``--frames A:B`` makes B scans."""
    scans = config.frames[1] if config.frames and config.frames[1] < UNBOUNDED else None
    for sequence in sequences:
        if not (root / "sequences" / sequence / "velodyne").is_dir() and not quiet:
            STDERR.print(f"simulating sequence {sequence} in {root} …", style="dim", soft_wrap=True)
        Simulated().make(root, sequence, scans, config.sensor)


def _watch(request: RunRequest, plans: list[SequencePlan]) -> AbstractContextManager[Report]:
    scans = sum(plan.n_scans for plan in plans)
    if request.graph.reaches("evaluate"):
        return bar(2 * scans, "scans coded or measured", request.quiet)
    return bar(scans, "scans", request.quiet)


def _gather(
    request: RunRequest,
    config: RunConfig,
    root: Path,
    outcomes: list[Outcome],
    errors: list[ScanError],
    started: datetime,
) -> None:
    """Hand all that was measured to the report, with what earlier runs measured of what is still there."""
    out = request.out
    now, peak = _measured(ShardStore(out), outcomes, errors)
    before = record.recorded_run(out)
    measured = set(now["metrics"].column("sequence").to_pylist())
    kept = {s for s in before.get("inputs", {}) if archive_path(out, s).exists()} - measured
    asked = {outcome.plan.sequence for outcome in outcomes} | {error.sequence for error in errors}
    commands = {s: c for s, c in before.get("commands", {}).items() if s in kept}
    run = {
        "command": request.command,
        "commands": commands | dict.fromkeys(sorted(measured), request.command),
        "config": config.model_dump(mode="json"),
        "config_digest": config.digest,
        "tool_version": TOOL,
        "started": started.isoformat(timespec="seconds"),
        "finished": datetime.now(UTC).isoformat(timespec="seconds"),
        "source": f"{config.source}: {root}",
        "notes": _notes(config, commands),
        "inputs": {s: i for s, i in before.get("inputs", {}).items() if s in kept}
        | {o.plan.sequence: o.record["inputs"] for o in outcomes if o.record is not None},
        "worker_peak_mb": round(peak, 1),
    }
    for name in ("metrics", "times"):
        now[name] = record.with_earlier(out, name, now[name], kept)
    baselines = record.with_earlier(
        out, "baselines", now["baselines"], kept | measured, ("sequence", "baseline")
    )
    now["baselines"] = baselines.filter(record.among(baselines, now["metrics"], ("sequence", "name")))
    now["failures"] = record.with_earlier(out, "failures", now["failures"], kept - asked)
    record.record(out, run, **now)
    poses = {
        (sequence, name): pose
        for sequence in sorted(measured | kept)
        for name, pose in held_poses(ArchiveReader(archive_path(out, sequence))).items()
    }
    write_catalogue(catalogue_of(now["metrics"], poses), out)


def _measured(
    store: ShardStore, outcomes: list[Outcome], errors: list[ScanError]
) -> tuple[dict[str, pa.Table], float]:
    """The tables of this run, by the names that the report has for them; and the most memory of a worker, MB."""
    metrics = [METRICS.empty_table()]
    times: list[tuple[Any, ...]] = []
    peak = 0.0
    for outcome in outcomes:
        for number in sorted(outcome.metrics):
            table, facts = store.read(outcome.metrics[number])
            metrics.append(table.replace_schema_metadata(None).cast(METRICS))
            peak = max(peak, facts["peak_mb"])
        if outcome.record is not None:
            peak = max(peak, outcome.record["peak_mb"])
            times += [(outcome.plan.sequence, *row) for row in outcome.record["times"]]
    baselines = sorted((ref for outcome in outcomes for ref in outcome.baselines), key=lambda ref: ref.path)
    failures = [(e.sequence, e.scan, e.stage, "", e.reason) for e in errors]
    return {
        "metrics": pa.concat_tables(metrics),
        "baselines": store.together(baselines, BASELINES),
        "times": _table(times, TIMES),
        "failures": _table(failures, FAILURES),
    }, peak


def _table(rows: list[tuple[Any, ...]], schema: pa.Schema) -> pa.Table:
    """Lay rows out as a table, their values in the order of its columns."""
    named = [dict(zip(schema.names, row, strict=True)) for row in rows]
    return pa.Table.from_pylist(named, schema=schema)


def _notes(config: RunConfig, earlier: dict[str, str]) -> list[str]:
    """What a reader of the report must know; ``earlier``: by sequence, the command of an earlier run that measured it."""
    notes = []
    if config.labels == "network" and config.keep_movable:
        notes.append("labels: nothing is dropped, so no network was asked; ground is split off by geometry")
    for command in sorted(set(earlier.values())):
        names = ", ".join(sorted(s for s, c in earlier.items() if c == command))
        notes.append(f"{names}: measured by an earlier run, {command}")
    return notes
