"""Encode scans that are arrays, not files: the stages of a run, one after the other in this process."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import chain, islice
from pathlib import Path
from typing import Any

import pyarrow as pa
from pydantic import ValidationError

from salpcc.pipeline.checked import check_name, checked
from salpcc.pipeline.decode import decoded_scans
from salpcc.pipeline.verify import Verdict, compare
from salpcc.schemas.config import RunConfig
from salpcc.schemas.errors import ArchiveError, KindError, UsageError
from salpcc.schemas.extras import require
from salpcc.schemas.files import location
from salpcc.schemas.scan import Scan
from salpcc.schemas.shards import LAYER_COUNTS
from salpcc.stages.coding import code
from salpcc.stages.ingest.arrays import is_array, scan_from_arrays
from salpcc.stages.lattice.sensor_model import SensorModel, load_sensor
from salpcc.stages.residual_code.archive.format import ArchiveFacts, ScanEntry, ScanPayload
from salpcc.stages.residual_code.archive.writer import write_archive
from salpcc.stages.segment.weights_file import weights_digest, weights_path


def encode_scans(
    scans: Iterable[Scan] | Any,
    path: str | Path,
    sequence: str = "scans",
    *,
    overwrite: bool = False,
    **options: Any,
) -> Path:
    """Encode scans, or the points of one, to an archive; :class:`~salpcc.pipeline.archive.Archive` gives them back.

    Scans are taken one GOP at a time, so a generator of any length will do. Their names must differ and
    may hold no slash; names of digits are taken as frame numbers. Each GOP is decoded again and compared with its scans; the archive
    appears under its name when all of it is right.

    Args:
        scans: an iterable of them, or an array of points ``(N, 3)``, which goes with ``intensity=`` and any other fields of the
            points as arrays, such as ``ring=`` (:func:`~salpcc.stages.ingest.arrays.scan_from_arrays`).
        overwrite: replace a file that is there.
        options: fields of :class:`~salpcc.schemas.config.RunConfig`, e.g. ``max_error=0.01``. Arrays keep
            their movable points in one layer unless ``keep_movable=False``. With ``labels="given"`` every scan needs its
            ``classes``.

    Raises:
        UsageError: an option is wrong, or the file is there.
        KindError: a scan is no scan, or an array of another kind; a TypeError, too.
        SalpccError: the sensor is unknown, or what was written does not decode to the scans.

    Example::

        scan = Scan("000000", points, intensity)  # float32 (N, 3) in metres, float32 (N,)
        encode_scans([scan], "mine.mcap", max_error=0.01)
        encode_scans(points, "other.mcap", intensity=intensity, ring=ring, time=time)
    """
    arrays = {name: options.pop(name) for name in list(options) if is_array(options[name])}
    if is_array(scans):
        scans = [scan_from_arrays(scans, **arrays)]
    elif arrays:
        raise KindError(
            f"{', '.join(arrays)}: arrays go with points; of several scans make each by scan_from_arrays(points, …)"
        )
    try:
        config = resolve(RunConfig(**{"keep_movable": True, **options}))
    except ValidationError as error:
        first = error.errors()[0]
        raise UsageError(f"option {'.'.join(map(str, first['loc']))}: {first['msg']}") from error
    target = location(path)
    if target.exists() and not overwrite:
        raise UsageError(f"{target} is there already; overwrite=True replaces it")
    check_name(sequence, "sequence")
    first_scan = next(coming := checked(scans, config), None)
    if first_scan is None:
        raise UsageError(f"{target}: there are no scans to encode")
    sensor = load_sensor(config.sensor)
    layered = config.movable == "layered"
    labelled = config.stores_labels and first_scan.labels is not None
    facts = ArchiveFacts(sequence, "arrays", "", config.coding, sensor, layered, labelled)
    write_archive(target, facts, _gops(chain([first_scan], coming), config))
    return target


def resolve(config: RunConfig) -> RunConfig:
    """Fill in what the names in a configuration stand for: the digests of the sensor model and of the weights.

    Raises:
        SalpccError: one of them is not there.
        UsageError: what the configuration asks for needs an extra that is not installed.
    """
    if config.uses_network:
        require("segment", "telling what can move (--keep-movable goes without)")
    if config.profile == "paper":
        require("paper", "the profile paper")
    known = {"sensor_digest": load_sensor(config.sensor).digest}
    for field in ("sensor", "weights"):  # a file lies where this process says, whoever reads it
        if (file := Path(getattr(config, field))).suffix in (".json", ".safetensors"):
            known[field] = str(file.absolute())
    # Asked for in any case: a wrong name is told, used or not.
    digest = weights_digest(weights_path(config.weights))
    if config.uses_network:
        known["weights_digest"] = digest
    return config.model_copy(update=known)


def payloads_of(table: pa.Table) -> list[ScanPayload]:
    """Take the coded scans out of a PAYLOAD table."""

    def payload(layer: dict[str, Any], row: dict[str, Any], movable: ScanPayload | None) -> ScanPayload:
        labels = layer["coded_labels"]
        entry = ScanEntry(row["name"], **{name: layer[name] for name in LAYER_COUNTS}, labels=len(labels))
        return ScanPayload(entry, row["time"], row["frame_id"], layer["data"], movable, labels)

    return [
        payload(row, row, row["movable"] and payload(row["movable"], row, None))
        for row in table.drop_columns(["dropped_classes", "found_classes"]).to_pylist()
    ]


def _gops(scans: Iterator[Scan], config: RunConfig) -> Iterator[list[ScanPayload]]:
    sensor = load_sensor(config.sensor)
    place = 0
    while group := list(islice(scans, config.gop)):
        numbers = [int(scan.name) if scan.name.isdecimal() else place + at for at, scan in enumerate(group)]
        place += len(group)
        payloads = payloads_of(code(zip(numbers, group, strict=True), config)["residual_code"])
        _decode_again(group, payloads, config, sensor)
        yield payloads


def _decode_again(
    scans: list[Scan], payloads: list[ScanPayload], config: RunConfig, sensor: SensorModel
) -> None:
    """Decode what was coded and compare it with the scans.

    Raises:
        ArchiveError: it is something else; that is a fault of this tool.
    """
    verdict = Verdict("", "", asked_max_error_m=config.max_error)
    layered = config.movable == "layered"
    for back, scan in zip(decoded_scans(payloads, sensor, layered, labels=True), scans, strict=True):
        compare(back, scan, "the scan given", config.coding, verdict, config.movable == "dropped")
    if verdict.problems:
        raise ArchiveError(f"not written, as it would not come back right: {verdict.problems[0]}")
