"""Encode scans that are arrays, not files: the stages of a run, one after the other in this process."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import chain, islice
from pathlib import Path
from typing import Any

import pyarrow as pa
from pydantic import ValidationError

from salpcc.pipeline.checked import check_name, checked
from salpcc.pipeline.decode import DecodeOptions, decoded_scans
from salpcc.pipeline.verify import Verdict, compare
from salpcc.schemas.config import Coder, Effort, Labels, Profile, RunConfig
from salpcc.schemas.errors import ArchiveError, KindError, UsageError
from salpcc.schemas.extras import require
from salpcc.schemas.files import location, there
from salpcc.schemas.scan import Scan
from salpcc.schemas.shards import ASIDE, LAYER_COUNTS
from salpcc.stages.coding import code
from salpcc.stages.ingest.arrays import Array, is_array, scan_from_arrays
from salpcc.stages.lattice.sensor_model import SensorModel, load_sensor
from salpcc.stages.residual_code.archive.format import ArchiveFacts, ScanEntry, ScanPayload
from salpcc.stages.residual_code.archive.writer import write_archive
from salpcc.stages.segment.weights_file import weights_digest, weights_path


def encode_scans(
    scans: Iterable[Scan] | Array,
    path: str | Path,
    sequence: str = "scans",
    *,
    intensity: Array | None = None,
    overwrite: bool = False,
    max_error: float | None = None,
    movable_max_error: float | None = None,
    keep_movable: bool = True,
    drop_movable: bool = False,
    labels: Labels | Array = "network",
    classes: bool | Array = False,
    effort: Effort = "default",
    gop: int = 8,
    sensor: str = "hdl64e",
    profile: Profile = "sensor",
    coder: Coder = "ppmd",
    weights: str = "small",
    several_scans: bool = True,
    **arrays: Array,
) -> Path:
    """Encode scans, or the points of one, to an archive; :class:`~salpcc.pipeline.archive.Archive` gives them back.

    Scans are taken one GOP at a time, so a generator of any length will do. Their names must differ and
    may hold no slash; names of digits are taken as frame numbers. Each GOP is decoded again and compared with its scans; the archive
    appears under its name when all of it is right.

    Args:
        scans: an iterable of them, or an array of points ``(N, 3)``, which goes with ``intensity`` ``(N,)`` and ``arrays``.
        overwrite: replace a file that is there.
        max_error: metres (3-D) that no point is farther than from its source; None is bit-exact.
        movable_max_error: of the movable layer; 0 is bit-exact, None as ``max_error``.
        keep_movable: all in one layer; else what can move has a layer of its own, or is left out (``drop_movable``).
        labels: what can move is told by the ``network``, or ``given``: every scan has its ``classes``. Scans that have
            some keep them where the network is not asked.
        classes: store those that the network finds; with an array of points, their own.
        effort: ``fast`` takes less than half the time, ``max`` fewer bits.
        gop: scans a group, the unit of decoding.
        sensor: a shipped model, or a JSON file of ``calibrate``.
        profile: ``paper`` is its 64 x 2000 grid, whose residuals ``coder`` codes.
        weights: of the network: a shipped width, or a file.
        several_scans: whether the scans of a group settle their classes together.
        arrays: any other fields of an array of points, such as ``ring=`` and ``time=``
            (:func:`~salpcc.stages.ingest.arrays.scan_from_arrays`).

    Raises:
        UsageError: an option is wrong, or the file is there.
        KindError: an option is of another type or there is none such, a scan is no scan, an array of another kind; a TypeError, too.
        SalpccError: the sensor is unknown, or what was written does not decode to the scans.

    >>> import numpy as np
    >>> from salpcc import Archive, Scan, encode_scans
    >>> points = np.array([[1, 2, 0.5], [3, 4, 0.5]], np.float32)
    >>> path = encode_scans(points, folder / "mine.mcap", effort="fast", ring=np.array([7, 8], np.uint8))
    >>> Archive.open(path)[0].fields["ring"]
    array([7, 8], dtype=uint8)
    >>> scans = (Scan(f"{n:06d}", points + n, points[:, 2]) for n in range(9))  # of any length
    >>> len(Archive.open(encode_scans(scans, folder / "nine.mcap", effort="fast", max_error=0.01)))
    9
    """
    # Options have the names that they have in a run.
    options = {name: value for name, value in locals().items() if name in RunConfig.model_fields}
    fields = {name: value for name, value in (arrays | options).items() if is_array(value)}
    if unknown := arrays.keys() - fields.keys():
        name = min(unknown)
        raise KindError(
            f"option {name}: there is none, and {type(arrays[name]).__name__} is no array of a field of points"
        )
    listed = _listed(scans, intensity, fields)
    config = _config({name: value for name, value in options.items() if name not in fields})
    target = location(path)
    if there(target) and not overwrite:
        raise UsageError(f"{target} is there already; overwrite=True replaces it")
    check_name(sequence, "sequence")
    taken = iter(listed)
    first_given = next(taken, None)
    if first_given is None:
        raise UsageError(f"{target}: there are no scans to encode")
    if getattr(first_given, "classes", None) is not None and not config.uses_network:
        config = config.model_copy(update={"labels": "given"})  # nobody tells any others
    first_scan = next(coming := checked(chain([first_given], taken), config))
    model = load_sensor(config.sensor)
    layered = config.movable == "layered"
    labelled = config.stores_labels and first_scan.labels is not None
    facts = ArchiveFacts(sequence, "arrays", "", config.coding, model, layered, labelled)
    write_archive(target, facts, _gops(chain([first_scan], coming), config))
    return target


def _listed(scans: Iterable[Scan] | Array, intensity: Array | None, fields: dict[str, Any]) -> Iterable[Scan]:
    """The scans that are given, or the one that is made of arrays."""
    if is_array(scans):
        if own := {"points", "name", "stamp", "frame_id"} & fields.keys():
            raise UsageError(
                f"a field of points cannot be named {min(own)}, as scan_from_arrays has one of its own"
            )
        return [scan_from_arrays(scans, intensity, **fields)]
    if fields or intensity is not None:
        names = ", ".join([*(["intensity"] if intensity is not None else []), *fields])
        raise KindError(
            f"{names}: arrays go with points; of several scans make each by scan_from_arrays(points, …)"
        )
    if not isinstance(scans, Iterable):
        raise KindError(f"{type(scans).__name__} is neither scans nor an array of points")
    return scans


def _config(options: dict[str, Any]) -> RunConfig:
    try:
        return resolve(RunConfig(**options))
    except ValidationError as error:
        first = error.errors()[0]
        kind = KindError if first["type"].endswith("_type") else UsageError
        raise kind(f"option {'.'.join(map(str, first['loc']))}: {first['msg']}") from error


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
        for row in table.drop_columns(list(ASIDE)).to_pylist()
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
    decoded = decoded_scans(payloads, sensor, layered, DecodeOptions(labels=True))
    for back, scan in zip(decoded, scans, strict=True):
        compare(back, scan, "the scan given", config.coding, verdict, config.movable == "dropped")
    if verdict.problems:
        raise ArchiveError(f"not written, as it would not come back right: {verdict.problems[0]}")
