"""Make archives of the scans that were found in a catalogue."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import pyarrow as pa
import pyarrow.compute as pc

from salpcc.pipeline.edit.cut import Counts, check_new, write_part
from salpcc.pipeline.edit.merge import merge
from salpcc.schemas.errors import UsageError
from salpcc.schemas.passing_log import PassingLog
from salpcc.stages.residual_code.archive.reader import ArchiveReader


def export_found(found: pa.Table, out: Path, target: Path) -> Iterator[tuple[Path, Counts]]:
    """Write scans of archives in ``out`` to ``target``: one archive a sequence in a folder, or one NAME.mcap of all.

    Of logs, messages of other topics stay behind; the counts name them.

    Args:
        found: rows of the catalogue of ``out``.

    Raises:
        UsageError: a file is there already; archives do not fit into one.
        ArchiveError: one is damaged, or no longer holds what the catalogue says.
    """
    archives = list(dict.fromkeys(found.column("archive").to_pylist()))
    if target.suffix != ".mcap":
        for name in archives:
            path = target / Path(name).name
            yield path, _export(found, out, name, path)
        return
    check_new(target)
    with TemporaryDirectory() as folder:
        parts = [Path(folder) / Path(name).name for name in archives]
        counts = [_export(found, out, name, part) for name, part in zip(archives, parts, strict=True)]
        try:
            merge(parts, target)
        except UsageError as error:
            held = str((out / archives[0]).parent)
            raise UsageError(f"{str(error).replace(folder, held)}; or name a folder, not a file") from error
    behind = frozenset[str]().union(*(one.behind for one in counts))
    yield target, Counts(sum(one.copied for one in counts), sum(one.anew for one in counts), behind)


def _export(found: pa.Table, out: Path, archive: str, path: Path) -> Counts:
    rows = found.filter(pc.equal(found.column("archive"), archive))
    names = set(rows.column("name").to_pylist())
    reader = ArchiveReader(out / archive)
    if gone := sorted(names.difference(reader.names)):
        raise UsageError(
            f"{reader.path}: scan {gone[0]} is in the catalogue, not in the archive; run it again"
        )
    log = PassingLog(reader.log.values(), iter(()), reader.enclosed()) if reader.log else None
    wanted = [[entry.name for entry in gop if entry.name in names] for gop in reader.gops]
    counts = write_part(reader, wanted, path, log)
    return replace(counts, behind=frozenset(reader.passing_topics))
