"""Archives (read, verified and recovered), shards, and weights."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
from mutate import mutate_mcap
from payloads import small_scan
from target import Target, Wrong

from salpcc.pipeline import Archive, Scan, encode_scans
from salpcc.pipeline.edit.recover import recover
from salpcc.pipeline.schedule.store import ShardStore, read_shard
from salpcc.schemas.errors import SalpccError
from salpcc.schemas.log import LogAttachment, LogChannel, LogMessage, LogMetadata
from salpcc.schemas.passing_log import PassingLog
from salpcc.schemas.shards import sweeps_to_table, table_to_sweeps
from salpcc.schemas.work import ShardRef
from salpcc.stages.lattice.sensor_model import load_sensor
from salpcc.stages.lattice.sweep import scan_to_sweep
from salpcc.stages.residual_code.archive.reader import ArchiveReader
from salpcc.stages.residual_code.archive.side_files import SideFile
from salpcc.stages.residual_code.archive.writer import write_archive

SENSOR = load_sensor("hdl64e")


def _scans() -> list[Scan]:
    return [small_scan(SENSOR, np.random.default_rng(n)) for n in range(3)]


def _archives(folder: Path) -> list[bytes]:
    scans = [Scan(f"{n:06d}", s.points, s.intensity, 10**8 * n) for n, s in enumerate(_scans())]
    encode_scans(scans, folder / "a.mcap", gop=2, effort="fast", keep_movable=True)
    reader = ArchiveReader(folder / "a.mcap")
    enclosed = LogAttachment(1, 2, "index", "text/plain", b"[]"), LogMetadata("salpcc", (("a", "b"),))
    channel = LogChannel(1, "/texts", "json", "", "", b"")
    log = PassingLog([channel], iter([LogMessage(1, 5, 5, 0, b"{}")]), enclosed)
    gops = [reader.payloads(gop) for gop in range(len(reader.gops))]
    write_archive(folder / "b.mcap", reader.facts, gops, log)
    classes = [np.where(np.arange(len(s)) // 40 % 3 == 0, 1, 13).astype(np.uint8) for s in scans]
    labels = [np.where(c == 1, 10 | 5 << 16, 50).astype(np.uint32) for c in classes]
    both = [replace(s, classes=c, labels=n) for s, c, n in zip(scans, classes, labels, strict=True)]
    encode_scans(both, folder / "c.mcap", gop=2, effort="fast", labels="given", keep_movable=False)
    reader = ArchiveReader(folder / "c.mcap")
    gops = [
        [
            replace(one, movable=two)
            for one, two in zip(reader.payloads(g), reader.movable_payloads(g), strict=True)
        ]
        for g in range(len(reader.gops))
    ]
    write_archive(folder / "d.mcap", reader.facts, gops, side=SIDE)
    with Archive.open(folder / "d.mcap", layers="static") as archive:
        _wanted.update(scan.points.tobytes() for scan in archive)
    _labels.update(label.tobytes() for label in labels)
    return [(folder / name).read_bytes() for name in ("a.mcap", "b.mcap", "d.mcap")]


SIDE = [SideFile("poses.txt", b"1 0 0 0 0 1 0 0 0 0 1 0\n" * 9), SideFile("a/b.txt", b"b")]
_wanted = {s.points.tobytes() for s in _scans()}
_labels: set[bytes] = set()


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
            if not whole and scan.labels is not None and scan.labels.tobytes() not in _labels:
                raise Wrong("a damaged archive decoded to other labels")
        for name in archive.side:
            content = archive.side_file(name)
            if name.startswith("/") or ".." in name.split("/"):
                raise Wrong(f"the name {name!r} of a side file")
            if not whole and SideFile(name, content) not in SIDE:
                raise Wrong("a damaged archive gave another side file")


def _recover_archive(_: int, data: bytes, folder: Path) -> None:
    """What comes back is whole and verifies."""
    path, new = folder / "a.mcap", folder / "new.mcap"
    path.write_bytes(data)
    new.unlink(missing_ok=True)
    found = recover(path, new)
    reader = ArchiveReader(new)
    reader.check()
    if {SideFile(name, reader.side_file(name).data) for name in reader.side} - set(SIDE):
        raise Wrong("another side file was recovered")
    for layers in ("static", "all") if reader.movable == "layered" else ("all",):
        with Archive.open(new, layers=layers) as archive:  # type: ignore[arg-type]
            if len(archive) != found.scans or {s.points.tobytes() for s in archive} - _wanted:
                raise Wrong("another scan was recovered")


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
