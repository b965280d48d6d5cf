"""Encode scans that are arrays, not files: the stages of a run, one after the other in this process."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import islice
from pathlib import Path
from typing import Any

import pyarrow as pa

from salpcc.schemas.config import RunConfig
from salpcc.schemas.files import location
from salpcc.schemas.scan import Scan
from salpcc.schemas.shards import sweeps_to_table
from salpcc.stages.ground_fit import stage as ground_fit
from salpcc.stages.ingest.sensor_model import load_sensor
from salpcc.stages.ingest.stage import Projector
from salpcc.stages.predict import stage as predict
from salpcc.stages.residual_code import stage as residual_code
from salpcc.stages.residual_code.archive import ArchiveFacts, ScanEntry, ScanPayload
from salpcc.stages.residual_code.archive_writer import write_archive
from salpcc.stages.segment import stage as segment
from salpcc.stages.segment.weights_file import weights_digest, weights_path


def encode_scans(scans: Iterable[Scan], path: str | Path, sequence: str = "scans", **options: Any) -> Path:
    """Encode scans to an archive; :class:`~salpcc.pipeline.archive.Archive` gives them back.

    Scans are taken one GOP at a time, so a generator of any length will do. Their names must differ and
    may hold no slash; names of digits are taken as frame numbers.

    Args:
        options: fields of :class:`~salpcc.schemas.config.RunConfig`, e.g. ``max_error=0.01``. Arrays keep
            their movable points unless ``keep_movable=False``. With ``labels="given"`` every scan needs its
            ``classes``.

    Raises:
        SalpccError: an option is wrong, the sensor is unknown.
    """
    config = resolve(RunConfig(**{"keep_movable": True, **options}))
    facts = ArchiveFacts(sequence, "arrays", "", config.coding, load_sensor(config.sensor))
    write_archive(location(path), facts, _gops(iter(scans), config))
    return location(path)


def resolve(config: RunConfig) -> RunConfig:
    """Fill in what the names in a configuration stand for: the digests of the sensor model and of the weights.

    Raises:
        SalpccError: one of them is not there.
    """
    known = {"sensor_digest": load_sensor(config.sensor).digest}
    for field in ("sensor", "weights"):  # a file lies where this process says, whoever reads it
        if (file := Path(getattr(config, field))).suffix in (".json", ".safetensors"):
            known[field] = str(file.absolute())
    if config.uses_network:
        known["weights_digest"] = weights_digest(weights_path(config.weights))
    return config.model_copy(update=known)


def payloads_of(table: pa.Table) -> list[ScanPayload]:
    """Take the coded scans out of a PAYLOAD table."""
    counts = list(ScanEntry.__dataclass_fields__)
    return [
        ScanPayload(ScanEntry(**{k: row[k] for k in counts}), row["time"], row["frame_id"], row["data"])
        for row in table.drop_columns("dropped_classes").to_pylist()
    ]


def _gops(scans: Iterator[Scan], config: RunConfig) -> Iterator[list[ScanPayload]]:
    sensor = load_sensor(config.sensor)
    place = 0
    while group := list(islice(scans, config.gop)):
        project = Projector(sensor)
        sweeps = []
        for scan in group:
            sweeps.append(project(int(scan.name) if scan.name.isdecimal() else place, scan))
            place += 1
        task = segment.run(sweeps_to_table(sweeps), config)
        planes = ground_fit.run(task, config)
        yield payloads_of(residual_code.run(task, planes, predict.run(task, planes, config), config))
