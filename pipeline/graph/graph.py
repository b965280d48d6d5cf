"""The Dask graph: GOPs chain through the stages, a bounded number at a time, and sequences finish early.

Everything a task needs to know fits in a few hundred bytes; data move through the shard store. A GOP's
chain runs depth first; when the last GOP of a sequence is coded its archive is written, then its GOPs are
evaluated before new ones are begun.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from distributed import Client, Future

from salpcc.pipeline.graph.sequence import (
    archive_path,
    baseline_gop,
    evaluate_gop,
    finish,
    finished,
    inputs_digest,
    known_files,
)
from salpcc.pipeline.graph.tasks import GopResult, run_stage, source_digest
from salpcc.pipeline.plan.digests import all_known, recall
from salpcc.pipeline.plan.held import check_replaceable
from salpcc.pipeline.plan.plan import SequencePlan
from salpcc.pipeline.plan.records import recorded
from salpcc.pipeline.schedule.flow import Flow, each, value_of
from salpcc.pipeline.schedule.progress import Report
from salpcc.pipeline.schedule.store import ShardStore
from salpcc.schemas.config import RunConfig
from salpcc.schemas.errors import WorkersDiedError
from salpcc.schemas.work import STAGES, GopSource, ScanError, ShardRef

After = Callable[[Future[Any]], None]  # what is done with the result of a task
Job = tuple[Callable[[], Future[Any]], After]


@dataclass(frozen=True)
class GraphOptions:
    """How far to go: stages ``first`` to ``last``; what exists of stages before ``first`` is reused."""

    first: str = STAGES[0]
    last: str = STAGES[-1]
    forced: bool = False  # --from was given: redo `first` and what follows
    keep_shards: bool = False
    overwrite: bool = False  # replace archives that were made otherwise

    def redo(self, stage: str) -> bool:
        """Tell whether results of ``stage`` that exist are to be made again."""
        return self.forced and STAGES.index(stage) >= STAGES.index(self.first)

    def reaches(self, stage: str) -> bool:
        """Tell whether the run goes as far as ``stage``."""
        return STAGES.index(stage) <= STAGES.index(self.last)


@dataclass
class Outcome:
    """What became of a sequence: the record of its archive, METRICS shards by GOP, and so on."""

    plan: SequencePlan
    coded: dict[int, GopResult] = field(default_factory=dict)
    record: dict[str, Any] | None = None
    metrics: dict[int, ShardRef] = field(default_factory=dict)
    baselines: list[ShardRef] = field(default_factory=list)
    errors: list[ScanError] = field(default_factory=list)


class Graph:
    """One run of the graph on a client."""

    def __init__(
        self, client: Client, config: RunConfig, out: Path, options: GraphOptions, report: Report
    ) -> None:
        self._client, self._config, self._out = client, config, out
        self._options, self._report = options, report
        self._flow: Flow[After] = Flow(client)

    def run(self, plans: list[SequencePlan]) -> list[Outcome]:
        """Run all sequences; returns what became of each.

        Raises:
            SalpccError: something that is nobody's scan failed, such as the disk, or the scheduler is gone.
        """
        outcomes = [Outcome(plan) for plan in plans]
        for outcome in outcomes:
            self._begin(outcome)
        for after, future in self._flow:
            after(future)
        return outcomes

    def _begin(self, outcome: Outcome) -> None:
        """Queue the GOPs of a sequence, or only its evaluation where the archive is done."""
        options = self._options
        record = recorded(self._out, outcome.plan.sequence)
        outcome.plan = plan = recall(outcome.plan, record.get("files", {}), self._config)
        archive = archive_path(self._out, plan.sequence)
        if options.reaches("residual_code") and archive.is_file():
            digests = self._digests(plan)
            if not options.overwrite:
                inputs = inputs_digest(plan, digests, self._config)
                check_replaceable(archive, plan, inputs, record, self._config)
            reusable = not options.forced or options.first == "evaluate"
            if reusable and finished(plan, digests, record, self._config, self._out):
                outcome.record = record
            else:
                outcome.plan = plan = recall(plan, known_files(plan, digests), self._config)
        if outcome.record is not None:
            self._report.advance(plan.n_scans, f"{plan.sequence}: archive is done")
            self._flow.waiting.extend(self._evaluation(outcome))
            return
        for gop in plan.gops:
            self._flow.waiting.append((partial(self._chain, gop), partial(self._coded, outcome, gop)))

    def _digests(self, plan: SequencePlan) -> list[GopResult]:
        """Digest the source of each GOP; where files have to be read, workers do it."""
        unread = [gop for gop in plan.gops if not all_known(gop, self._config)]
        work = [(gop, self._config) for gop in unread]
        what = [f"digest of {gop.sequence}-{gop.number:05d}" for gop in unread]
        digests = each(self._client, source_digest, work, what)
        read = {gop.number: digest for gop, digest in zip(unread, digests, strict=True)}
        return [read.get(gop.number) or source_digest(gop, self._config) for gop in plan.gops]

    def _chain(self, gop: GopSource) -> Future[Any]:
        name = f"{gop.sequence}-{gop.number:05d}"
        future = self._flow.submit(f"digest-{name}", source_digest, gop, self._config)
        for stage in STAGES[:-1]:
            if not self._options.reaches(stage):
                break
            redo = self._options.redo(stage)
            future = self._flow.submit(
                f"{stage}-{name}", run_stage, stage, future, gop, self._config, self._out, redo
            )
        return future

    def _coded(self, outcome: Outcome, gop: GopSource, future: Future[Any]) -> None:
        result = self._result(future, gop, "residual_code")
        outcome.coded[gop.number] = result
        for error in result.errors:
            self._report.say(f"{error.sequence}/{error.scan}: {error.stage}: {error.reason}")
        self._report.advance(len(gop.scans), f"{gop.sequence}: coded GOP {gop.number}")
        if len(outcome.coded) < len(outcome.plan.gops):
            return
        results = [outcome.coded[g.number] for g in outcome.plan.gops]
        if not self._options.reaches("residual_code"):
            outcome.errors += [error for result in results for error in result.errors]
            return
        plan = outcome.plan
        start = partial(
            self._flow.submit,
            f"archive-{plan.sequence}",
            finish,
            plan,
            results,
            self._config,
            self._out,
        )
        self._flow.waiting.appendleft((start, partial(self._archived, outcome)))

    def _archived(self, outcome: Outcome, future: Future[Any]) -> None:
        outcome.record = value_of(future, f"archive of {outcome.plan.sequence}")
        if outcome.record is None:
            outcome.errors += [error for result in outcome.coded.values() for error in result.errors]
            archive = archive_path(self._out, outcome.plan.sequence)
            self._report.say(
                f"{outcome.plan.sequence}: {archive} stays as it was, as it holds more than came back now"
                if archive.is_file()
                else f"{outcome.plan.sequence}: no scan came back, so no archive was written"
            )
            return
        if not self._options.keep_shards:
            ShardStore(self._out).drop_sequence(outcome.plan.sequence, STAGES[:-1])
        self._flow.waiting.extendleft(reversed(self._evaluation(outcome)))

    def _evaluation(self, outcome: Outcome) -> list[Job]:
        """The archive is there: what is left to do is to measure its GOPs."""
        assert outcome.record is not None
        outcome.errors += [ScanError(**error) for error in outcome.record["errors"]]
        if not self._options.reaches("evaluate"):
            return []
        redo, inputs = self._options.redo("evaluate"), outcome.record["inputs"]
        jobs: list[Job] = []
        for gop in outcome.plan.gops:
            name = f"{gop.sequence}-{gop.number:05d}"
            start = partial(
                self._flow.submit,
                f"evaluate-{name}",
                evaluate_gop,
                gop,
                inputs,
                self._config,
                self._out,
                redo,
            )
            jobs.append((start, partial(self._measured, outcome, gop)))
        for baseline in self._config.baselines:
            for gop in outcome.plan.gops:
                name = f"{baseline}-{gop.sequence}-{gop.number:05d}"
                start = partial(
                    self._flow.submit, f"baseline-{name}", baseline_gop, baseline, gop, self._out, redo
                )
                jobs.append((start, partial(self._compared, outcome, baseline, gop)))
        return jobs

    def _measured(self, outcome: Outcome, gop: GopSource, future: Future[Any]) -> None:
        result = self._result(future, gop, "evaluate")
        outcome.errors += result.errors
        if not result.failed:
            outcome.metrics[gop.number] = dict(result.shards)["evaluate"]
        self._report.advance(len(gop.scans), f"{gop.sequence}: measured GOP {gop.number}")

    def _compared(self, outcome: Outcome, baseline: str, gop: GopSource, future: Future[Any]) -> None:
        result = self._result(future, gop, "evaluate")
        outcome.errors += result.errors
        if not result.failed:
            outcome.baselines.append(dict(result.shards)["baseline"])
        self._report.advance(0, f"{gop.sequence}: measured {baseline} on GOP {gop.number}")

    @staticmethod
    def _result(future: Future[Any], gop: GopSource, stage: str) -> GopResult:
        """The result of a GOP's task; workers that keep dying of it cost this GOP, not the run."""
        try:
            result: GopResult = value_of(future, f"{gop.sequence}-{gop.number:05d}")
            return result
        except WorkersDiedError as error:
            errors = tuple(ScanError(gop.sequence, scan.name, stage, error.reason) for scan in gop.scans)
            return GopResult("", "", errors=errors, failed=True)
