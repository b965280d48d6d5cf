"""What happens once per sequence: its archive, the record of how it was made, and its evaluation."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from salpcc.pipeline.decode import decode_scans
from salpcc.pipeline.encode import payloads_of
from salpcc.pipeline.graph.tasks import GopResult, lost
from salpcc.pipeline.plan.held import held_scans
from salpcc.pipeline.plan.plan import SequencePlan
from salpcc.pipeline.plan.records import write_record
from salpcc.pipeline.plan.side_files import side_files, unfit_labels
from salpcc.pipeline.schedule.machine import peak_mb
from salpcc.pipeline.schedule.store import ShardStore
from salpcc.schemas.config import RunConfig
from salpcc.schemas.errors import ArchiveError, SourceError
from salpcc.schemas.files import unreachable
from salpcc.schemas.scan import Scan
from salpcc.schemas.shards import ASIDE, OF_RETURNS, list_array
from salpcc.schemas.work import GopSource, Known, ScanRef, ShardRef, digest_of
from salpcc.stages.coding import STAGES
from salpcc.stages.evaluate import stage as evaluate
from salpcc.stages.evaluate.baselines import BASELINES
from salpcc.stages.evaluate.baselines import measure_baseline as measure
from salpcc.stages.evaluate.baselines.apart import measure_scans
from salpcc.stages.evaluate.report.baseline_figures import OURS
from salpcc.stages.ingest.sources import SOURCES
from salpcc.stages.lattice.sensor_model import load_sensor
from salpcc.stages.residual_code.archive.format import ArchiveFacts, ScanPayload
from salpcc.stages.residual_code.archive.reader import ArchiveReader
from salpcc.stages.residual_code.archive.side_files import SideFile
from salpcc.stages.residual_code.archive.writer import write_archive
from salpcc.stages.residual_code.sensor.scan_coder import on_lattice

_warm: set[str] = set()  # efforts that this process has decoded


def archive_path(out: Path, sequence: str) -> Path:
    """Where the archive of a sequence lies."""
    return out / "archives" / f"{sequence}.mcap"


def inputs_digest(plan: SequencePlan, results: list[GopResult], config: RunConfig) -> str:
    """Digest what an archive is made of; ``results`` are those of :func:`source_digest`, or of later stages, by GOP."""
    source = plan.gops[0].source
    # The frames decide what passes through, too, also where they are all there are.
    frames = [config.frames] if config.frames and SOURCES[source].passes else []
    side = [[[ref.name, ref.digest] for ref in plan.side]] if plan.side else []
    return digest_of(
        plan.sequence, source, config.digest, [result.origin for result in results], *frames, *side
    )


def finished(
    plan: SequencePlan, results: list[GopResult], record: dict[str, Any], config: RunConfig, out: Path
) -> bool:
    """Tell whether the archive of a sequence is complete and made of these very inputs.

    It has to be made where there is none or a damaged one, where other inputs went into it, or GOPs failed.
    """
    try:
        inputs = ArchiveReader(archive_path(out, plan.sequence)).facts.inputs
    except ArchiveError:
        return False
    if not inputs == inputs_digest(plan, results, config) == record.get("inputs"):
        return False
    # What failed to be read is done again when its bytes change; what failed in a kernel is tried again.
    if any(error["stage"] != "ingest" for error in record["errors"]):
        return False
    if any(result.learned for result in results):  # files were touched, and hold what they held
        write_record(record | {"files": known_files(plan, results)}, out, plan.sequence)
    return True


def finish(
    plan: SequencePlan, results: list[GopResult], config: RunConfig, out: Path
) -> dict[str, Any] | None:
    """Write the record of a sequence, then its archive from the payload shards; return the record.

    None, and nothing is written, where no scan came back, or some failed and the archive that is there holds more.
    """
    store = ShardStore(out)
    failed = {error.scan for result in results for error in result.errors}
    came = plan.n_scans - len(failed)
    if not came or (failed and came < len(held_scans(archive_path(out, plan.sequence)))):
        return None
    source, refs = SOURCES[plan.gops[0].source], [ref for gop in plan.gops for ref in gop.scans]
    record: dict[str, Any] = {
        "inputs": inputs_digest(plan, results, config),
        "files": known_files(plan, results),
        "places": {} if config.frames else source.places(refs),
        "errors": [],
        "times": [],
        "peak_mb": 0.0,
    }
    for gop, result in zip(plan.gops, results, strict=True):
        record["errors"] += [vars(error) for error in result.errors]
        if result.failed:
            continue
        facts = store.facts(dict(result.shards)["residual_code"])
        record["times"] += [[gop.number, *row] for row in facts["times"]]
        record["peak_mb"] = max(record["peak_mb"], facts["peak_mb"])
    write_record(record, out, plan.sequence)
    log = source.passing(refs, {error["scan"] for error in record["errors"]}, config.frames)
    # Whoever compares the archive of a log with it must know what was left out.
    of_log = {"frames": list(config.frames)} if log and config.frames else {}
    facts_ = ArchiveFacts(
        plan.sequence,
        source.name,
        record["inputs"],
        config.coding | of_log,
        load_sensor(config.sensor),
        config.movable == "layered",
        config.stores_labels and any(ref.labels for gop in plan.gops for ref in gop.scans),
    )
    unlabelled: list[ScanRef] = []

    def payloads() -> Iterator[list[ScanPayload]]:
        for gop, result in zip(plan.gops, results, strict=True):
            coded = _payloads(store, result, _aside_ref(store, gop, record["inputs"]))
            bare = {payload.entry.name for payload in coded if not payload.labels}
            unlabelled.extend(ref for ref in gop.scans if ref.labels and ref.name in bare)
            yield coded

    def side() -> Iterator[SideFile]:
        # Labels that fit no points are kept as they are, but not those of points that were dropped.
        unfit = unlabelled if config.stores_labels and config.movable != "dropped" else []
        yield from side_files([*plan.side, *filter(None, map(unfit_labels, unfit))])

    write_archive(archive_path(out, plan.sequence), facts_, payloads(), log, side())
    return record


def known_files(plan: SequencePlan, results: list[GopResult]) -> Known:
    """What the next run may know of the files without reading them."""
    return plan.known | {name: known for result in results for name, known in result.learned.items()}


def _payloads(store: ShardStore, result: GopResult, put: ShardRef) -> list[ScanPayload]:
    """The payloads of a GOP; what is known of its scans and not in the archive is put aside for the evaluation."""
    if result.failed:
        return []
    table, _ = store.read(dict(result.shards)["residual_code"])
    aside = table.select(["name", *ASIDE])
    if any(aside.column(name).null_count < len(aside) for name in aside.column_names[1:]):
        store.write(put, aside, {"stage": "evaluate"})
    return payloads_of(table)


def _aside_ref(store: ShardStore, gop: GopSource, inputs: str) -> ShardRef:
    return store.ref(gop.sequence, "aside", gop.number, inputs)


def evaluate_gop(gop: GopSource, inputs: str, config: RunConfig, out: Path, redo: bool) -> GopResult:
    """Decode one GOP from the archive and measure it against its source; the result is a METRICS shard.

    The shard is named by what the archive holds of the GOP, too: the same inputs give another archive when
    scans that failed are tried again.
    """
    store = ShardStore(out)
    result = GopResult(inputs, inputs)
    try:
        reader = ArchiveReader(archive_path(out, gop.sequence))
        payloads = reader.payloads(gop.number)
        moving = reader.movable_payloads(gop.number)
        content = [[vars(payload.entry), payload.checksum] for payload in payloads + moving]
        digest = digest_of(inputs, "evaluate", evaluate.VERSION, gop.number, content)
        ref = store.ref(gop.sequence, "evaluate", gop.number, digest)
        result = GopResult(inputs, digest, (("evaluate", ref),))
        if not redo and store.found(ref) is not None:
            return result
        entries = reader.entries[gop.number]
        names = {entry.name for entry in entries}
        layers = {payload.entry.name: payload for payload in moving}
        dropped, found, of_returns = _aside(store, gop, inputs)
        if reader.movable == "layered":  # it is all there
            dropped = dict.fromkeys(names)
        refs = [scan for scan in gop.scans if scan.name in names]
        _warm_up(reader, gop.number)
        table = evaluate.run(
            decode_scans(reader, gop.number),
            _originals(gop, refs, with_labels=config.uses_network or config.labels == "given"),
            pa.Table.from_pylist(
                [
                    vars(entry)
                    | {"movable": reader.movable}
                    | _of_layers(payload, layers.get(payload.entry.name))
                    | _on_lattice(config, payload, layers.get(payload.entry.name))
                    | of_returns.get(entry.name, {})
                    for entry, payload in zip(entries, payloads, strict=True)
                ]
            ),
            sequence=gop.sequence,
            gop=gop.number,
            sensor=reader.facts.sensor,
            max_error=config.largest_error,
            dropped=dropped,
            found=found,
            in_order=config.profile == "sensor",
            sample=gop.number == 0,
        )
    except Exception as error:
        if unreachable(error):
            raise
        return lost("evaluate", result, gop, error)
    peak = peak_mb()
    store.write(ref, table, {"stage": "evaluate", "stage_version": evaluate.VERSION, "peak_mb": peak})
    return result


_Aside = dict[str, NDArray[np.uint8] | None]


def _aside(
    store: ShardStore, gop: GopSource, inputs: str
) -> tuple[_Aside, _Aside, dict[str, dict[str, Any]]]:
    """By scan, the classes of what was dropped, those of all points as they were found, and what is known of the returns.

    Empty where nobody put them aside (another run's archive).
    """
    ref = _aside_ref(store, gop, inputs)
    if not store.has(ref):
        return {}, {}, {}
    table, _ = store.read(ref)
    names = table.column("name").to_pylist()
    dropped, found = (
        {name: list_array(table, column, row) for row, name in enumerate(names)}
        for column in ("dropped_classes", "found_classes")
    )
    of_returns = table.select(list(OF_RETURNS.names)).to_pylist()
    return dropped, found, dict(zip(names, of_returns, strict=True))


def _of_layers(static: ScanPayload, movable: ScanPayload | None) -> dict[str, Any]:
    """Points and bytes of the movable layer of a scan, and the checksums of both."""
    if movable is None:
        return {"points_movable": None, "bytes_movable": None, "checksum": static.checksum}
    entry, checksum = movable.entry, f"{static.checksum}-{movable.checksum}"
    return {"points_movable": entry.kept, "bytes_movable": entry.bytes, "checksum": checksum}


def _on_lattice(config: RunConfig, static: ScanPayload, movable: ScanPayload | None) -> dict[str, Any]:
    """Points of a scan that no lattice of its sensor explains, and whether its points lie where the sensor saw them; the grid of profile ``paper`` has none."""
    layers = [static, *([movable] if movable else [])] if config.profile == "sensor" else []
    seen = [on_lattice(layer.data) for layer in layers]
    unmoved = bool(seen) and all(layer.unmoved for layer in seen)
    return {"off_lattice": sum(layer.off for layer in seen), "unmoved": unmoved}


def _warm_up(reader: ArchiveReader, gop: int) -> None:
    """Decode two scans for nothing the first time in a process, so that numba has compiled what is measured: ``max`` looks back."""
    effort = str(reader.facts.config.get("effort"))
    if effort not in _warm:
        for _ in zip(range(2), decode_scans(reader, gop), strict=False):
            pass
        _warm.add(effort)


def _originals(gop: GopSource, refs: list[ScanRef], with_labels: bool) -> Iterator[Scan | None]:
    """The source's scans; labels only where there are classes to score."""
    source = SOURCES[gop.source]
    for ref in refs:
        try:
            yield source.read(ref, with_labels=with_labels and ref.labels is not None)
        except SourceError:
            yield source.read(ref, with_labels=False)


def baseline_gop(name: str, gop: GopSource, out: Path, redo: bool) -> GopResult:
    """Measure a baseline on the scans of one GOP; the result is a BASELINES shard.

    What the archive was asked for does not matter to a baseline, so its shards serve any run in ``out``. One that
    lacks its program or package is asked again by the next run.
    """
    store = ShardStore(out)
    scans = [[ref.name, *SOURCES[gop.source].digest(ref, with_labels=False)[0]] for ref in gop.scans]
    more: list[Any] = (
        [{stage.name: stage.version for stage in STAGES.values()}] if name == OURS else []
    )  # our own codec changes
    if missing := BASELINES[name].missing():
        more.append(missing)
    digest = digest_of("baseline", name, measure.VERSION, scans, *more)
    ref = store.ref(gop.sequence, f"baseline-{name}", gop.number, digest)
    result = GopResult(digest, digest, (("baseline", ref),))
    if redo or store.found(ref) is None:
        table = measure_scans(name, _readable(gop), gop.sequence)
        store.write(ref, table, {"stage": "evaluate", "stage_version": evaluate.VERSION, "baseline": name})
    return result


def _readable(gop: GopSource) -> Iterator[Scan]:
    """The scans that can be read; ingest has told of the others."""
    for ref in gop.scans:
        try:
            yield SOURCES[gop.source].read(ref, with_labels=False)
        except SourceError:
            continue
