"""Say what is in an archive or a shard, without decoding it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from salpcc.pipeline.schedule.store import read_shard
from salpcc.pipeline.verify import layer_sizes
from salpcc.stages.residual_code.archive.format import ScanEntry
from salpcc.stages.residual_code.archive.reader import ArchiveReader


def inspect(path: Path) -> dict[str, Any]:
    """Describe an archive (``.mcap``) or a shard (``.arrow``).

    Raises:
        ArchiveError, ShardError: damaged, or not one of ours.
    """
    return inspect_shard(path) if path.suffix == ".arrow" else inspect_archive(path)


def inspect_archive(path: Path) -> dict[str, Any]:
    """Describe an archive: its facts, its totals, and a row per scan."""
    reader = ArchiveReader(path)
    facts = reader.facts
    first, last = reader.span
    scans = [{"gop": number, **vars(entry)} for number, gop in enumerate(reader.entries) for entry in gop]
    counts = [name for name in ScanEntry.__dataclass_fields__ if name != "name"]
    return {
        "kind": "archive",
        "path": str(path),
        "sequence": facts.sequence,
        "source": facts.source,
        "config": facts.config,
        "sensor": facts.sensor.name,
        "lasers": facts.sensor.n_lasers,
        "gops": len(reader.gops),
        "scans": len(scans),
        "bytes": reader.size,
        "bytes_container": reader.container_bytes,
        "bytes_passing": reader.passing_bytes,
        "seconds": (last - first) / 1e9,
        "topics": sorted({channel.topic for channel in reader.log.values()}),
        "movable": reader.movable,
        "layers": layer_sizes(reader),
        "side_files": reader.side,
        "bytes_labels": reader.labels_bytes,
        "totals": {name: sum(scan[name] for scan in scans) for name in counts},
        "rows": scans,
    }


def inspect_shard(path: Path) -> dict[str, Any]:
    """Describe a shard: who wrote it from what, its columns, and the scalars of its rows."""
    table, facts = read_shard(path)
    simple = [f.name for f in table.schema if f.type.num_fields == 0 and f.name != "data"]
    return {
        "kind": "shard",
        "path": str(path),
        "facts": facts,
        "columns": {field.name: str(field.type) for field in table.schema},
        "rows": table.select(simple).to_pylist(),
    }
