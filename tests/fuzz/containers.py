"""Archives (read, verified and recovered), shards, and weights."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
from mutate import mutate_mcap
from payloads import small_scan
from target import Target, Wrong

from salpcc.pipeline import Archive, Scan, encode_scans
from salpcc.pipeline.recover import recover
from salpcc.pipeline.store import ShardStore, read_shard
from salpcc.schemas.errors import SalpccError
from salpcc.schemas.log import LogAttachment, LogChannel, LogMessage, LogMetadata
from salpcc.schemas.shards import sweeps_to_table, table_to_sweeps
from salpcc.schemas.work import ShardRef
from salpcc.stages.lattice.sensor_model import load_sensor
from salpcc.stages.lattice.sweep import scan_to_sweep
from salpcc.stages.residual_code.archive.passing import PassingLog
from salpcc.stages.residual_code.archive.reader import ArchiveReader
from salpcc.stages.residual_code.archive.writer import write_archive

SENSOR = load_sensor("hdl64e")


def _scans() -> list[Scan]:
    return [small_scan(SENSOR, np.random.default_rng(n)) for n in range(3)]


def _archives(folder: Path) -> list[bytes]:
    scans = [Scan(f"{n:06d}", s.points, s.intensity, 10**8 * n) for n, s in enumerate(_scans())]
    encode_scans(scans, folder / "a.mcap", gop=2, effort="fast", keep_movable=True)
    reader = ArchiveReader(folder / "a.mcap")
    enclosed = LogAttachment(1, 2, "index.json", "text/plain", b"[]"), LogMetadata("salpcc", (("a", "b"),))
    channel = LogChannel(1, "/texts", "json", "", "", b"")
    log = PassingLog([channel], iter([LogMessage(1, 5, 5, 0, b"{}")]), enclosed)
    gops = [reader.payloads(gop) for gop in range(len(reader.gops))]
    write_archive(folder / "b.mcap", reader.facts, gops, log)
    return [(folder / name).read_bytes() for name in ("a.mcap", "b.mcap")]


_wanted = {s.points.tobytes() for s in _scans()}


def _read_archive(_: int, data: bytes, folder: Path) -> None:
    """What the checksums let pass is what was written, unless they were mended; names never lead out."""
    path = folder / "a.mcap"
    path.write_bytes(data)
    try:
        reader = ArchiveReader(path)
        reader.check()
        whole = True
    except SalpccError:
        whole = False
    with Archive.open(path) as archive:
        for _ in (*archive.passing(), *archive.enclosed()):
            pass
        for scan in archive:
            if "/" in scan.name or "\\" in scan.name or scan.name in ("", ".", ".."):
                raise Wrong(f"the name {scan.name!r}")
            if not whole and scan.points.tobytes() not in _wanted:
                raise Wrong("a damaged archive decoded to another scan")


def _recover_archive(_: int, data: bytes, folder: Path) -> None:
    """What comes back is whole and verifies."""
    path, new = folder / "a.mcap", folder / "new.mcap"
    path.write_bytes(data)
    new.unlink(missing_ok=True)
    found = recover(path, new)
    with Archive.open(new) as archive:
        if len(archive) != found.scans or {s.points.tobytes() for s in archive} - _wanted:
            raise Wrong("another scan was recovered")
    ArchiveReader(new).check()


_TABLES = [
    sweeps_to_table([scan_to_sweep(scan, SENSOR) for scan in _scans()[:2]]),
    # Nulls, texts, empty lists: what makes Arrow follow offsets.
    pa.table(
        {"s": ["a", None, "ccc"], "l": [[1.5], None, []], "b": [b"x", b"", None], "t": [True, None, False]}
    ),
]


def _shards(folder: Path) -> list[bytes]:
    store, ref = ShardStore(folder), ShardRef("whole.arrow", "0" * 64)
    found = []
    for table in _TABLES:
        store.write(ref, table, {"errors": [], "times": []})
        found.append((store.root / ref.path).read_bytes())
    return found


def _read_shard(which: int, data: bytes, folder: Path) -> None:
    path = folder / "a.arrow"
    path.write_bytes(data)
    table, _facts = read_shard(path)
    if not table.replace_schema_metadata(None).equals(_TABLES[which].replace_schema_metadata(None)):
        raise Wrong("a damaged shard gave another table")
    if which == 0:
        table_to_sweeps(table)


TARGETS = {
    "archive": Target(_archives, _read_archive, 0.1, mutate_mcap),
    "archive, recovered": Target(_archives, _recover_archive, 0.04),
    "shard": Target(_shards, _read_shard, 0.05),
}
