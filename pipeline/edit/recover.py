"""Recover a damaged archive: every scan that is still whole goes to a new archive, the others are named."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from salpcc.pipeline.decode import DecodeOptions, decode_scans, decoded_scans
from salpcc.schemas.errors import ArchiveError, UsageError
from salpcc.schemas.files import there
from salpcc.stages.lattice.sensor_model import SensorModel
from salpcc.stages.residual_code.archive.format import ScanPayload
from salpcc.stages.residual_code.archive.reader import ArchiveReader
from salpcc.stages.residual_code.archive.salvage import Salvage
from salpcc.stages.residual_code.archive.writer import write_archive


@dataclass
class Recovery:
    """What came back. ``gone`` names the scans that did not; ``notes`` say what else is gone or not known."""

    archive: str
    out: str
    sequence: str
    scans: int = 0
    gone: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    @property
    def complete(self) -> bool:
        """Tell whether nothing is gone."""
        return not self.gone and not self.notes

    def as_dict(self) -> dict[str, Any]:
        """The findings as JSON, with ``complete`` first."""
        return {"complete": self.complete, **asdict(self)}


def recover(path: Path, out: Path, sensor: SensorModel | None = None) -> Recovery:
    """Write to ``out`` the scans of ``path`` whose checksums hold and that decode.

    A whole archive comes back byte for byte. Of a broken GOP its scans before the damage come back, for
    later ones cannot be decoded without them.

    Args:
        sensor: takes the place of a sensor model that is gone.

    Raises:
        ArchiveError: there is nothing to recover.
        UsageError: ``out`` exists.
    """
    if there(out):
        raise UsageError(f"{out}: exists; recover writes a new file")
    source = Salvage(path, sensor)
    found = Recovery(str(path), str(out), source.facts.sequence, notes=list(source.notes))
    gops = []
    for number, names in enumerate(source.names):
        payloads = _that_decode(source, number)
        if source.movable == "layered":
            payloads = _with_layers(source, number, payloads)
            bare = [payload.entry.name for payload in payloads if payload.movable is None]
            if bare:
                found.notes.append(
                    f"movable layer gone of scan {', '.join(bare)}; --layers static has the rest"
                )
        unlabelled = [
            payload.entry.name
            for payload in payloads
            if (not payload.labels and source.had_labels(payload.entry.name, False))
            or (
                payload.movable is not None
                and not payload.movable.labels
                and source.had_labels(payload.entry.name, True)
            )
        ]
        if unlabelled:
            found.notes.append(f"labels gone of scan {', '.join(unlabelled)}")
        gops.append(payloads)
        found.scans += len(payloads)
        came = {payload.entry.name for payload in payloads}
        found.gone += [name for name in names or () if name not in came]
        if names is None:
            found.notes.append(f"GOP {number}: which scans it held is not known, {len(came)} came back")
    if not source.all_known:
        last = next((payload.entry.name for gop in reversed(gops) for payload in gop[-1:]), "none")
        found.notes.append(f"the index is gone: what came after scan {last} is gone, too, if anything did")
    side, lost = source.side_files()
    if lost:
        found.notes.append(f"{lost} side files are gone")
    log, damaged = source.passing_log()
    if not source.ended:
        found.notes.append(
            "the end of the file is gone: side files, and what else a log enclosed, are gone, too, if there were more"
        )
    if damaged:
        found.notes.append(f"{damaged} chunks or attachments of the rest of the log are gone")
    if not found.scans and not found.complete:
        raise ArchiveError(f"{path}: no scan of it is whole")
    # Without its inputs no run takes it for an archive that is finished.
    facts = replace(source.facts, inputs=_inputs(path) if found.complete else "")
    write_archive(out, facts, gops, log, side)
    return found


def _inputs(path: Path) -> str:
    """The digest of the inputs, which only an archive without any damage is believed."""
    try:
        reader = ArchiveReader(path)
        reader.check()
    except ArchiveError:
        return ""
    return reader.facts.inputs


def _that_decode(source: Salvage, gop: int) -> list[ScanPayload]:
    """Take the scans of a GOP up to the first that does not decode."""
    payloads = source.payloads(gop)
    good = 0
    try:
        for _ in decode_scans(source, gop, DecodeOptions("static")):
            good += 1
    except (ArchiveError, ValueError):
        pass
    return payloads[:good]


def _with_layers(source: Salvage, gop: int, payloads: list[ScanPayload]) -> list[ScanPayload]:
    """Add their movable layers to scans, up to the first that does not decode."""
    layers = source.movable_payloads(gop)
    whole = [replace(payload, movable=layer) for payload, layer in zip(payloads, layers, strict=False)]
    good = 0
    try:
        for _ in decoded_scans(whole, source.facts.sensor, layered=True):
            good += 1
    except (ArchiveError, ValueError):
        pass
    return whole[:good] + payloads[good:]
