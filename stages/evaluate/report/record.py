"""Keep what was measured under ``OUT/report/``: the inputs of the report, as Parquet and JSON."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from collections.abc import Set as AbstractSet
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from salpcc.schemas.errors import ShardError
from salpcc.schemas.files import atomic
from salpcc.stages.evaluate.report import schema
from salpcc.stages.evaluate.report.schema import VERSION

SCHEMAS: Mapping[str, pa.Schema] = {
    "metrics": schema.METRICS,
    "times": schema.TIMES,
    "failures": schema.FAILURES,
    "baselines": schema.BASELINES,
    "registration": schema.REGISTRATION,
    "localisation": schema.LOCALISATION,
    "map_quality": schema.MAP_QUALITY,
    "coders": schema.CODERS,
    "ablations": schema.ABLATIONS,
    "pictures": schema.PICTURES,
}
RUN = "run.json"
_VERSION_KEY = b"salpcc.evaluate.version"


def record(out: Path, run: Mapping[str, Any] | None = None, **tables: pa.Table) -> None:
    """Write tables by the names of :data:`SCHEMAS` (``metrics=``, ``registration=``, …) and a run's description.

    A table replaces the one that is there; columns that it lacks are null.

    ``run`` is any JSON object; the report shows ``command``, ``config``, ``config_digest``, ``tool_version``,
    ``started``, ``finished`` (ISO 8601), ``notes`` (list of lines), ``source`` (where the scans came from) and
    ``inputs`` (by sequence, the digest of its scans and the configuration).
    """
    folder = out / "report"
    for name, table in tables.items():
        stamped = SCHEMAS[name].with_metadata({_VERSION_KEY: str(VERSION).encode()})
        with atomic(folder / f"{name}.parquet") as stream:
            pq.write_table(_complete(table, SCHEMAS[name]).cast(stamped), stream, compression="zstd")
    if run is not None:
        with atomic(folder / RUN) as stream:
            stream.write((json.dumps(run, indent=1, sort_keys=True) + "\n").encode())


def recorded(out: Path, name: str) -> pa.Table:
    """Read one table back; an empty one where the run wrote none.

    Raises:
        ShardError: the file is unreadable or comes from a newer version.
    """
    path = out / "report" / f"{name}.parquet"
    if not path.exists():
        return SCHEMAS[name].empty_table()
    return _complete(read_stamped(path, _VERSION_KEY, VERSION), SCHEMAS[name])


def read_stamped(path: Path, key: bytes, newest: int) -> pa.Table:
    """Read a Parquet file whose metadata say its version under ``key``, versions up to ``newest``.

    Raises:
        ShardError: the file is unreadable or comes from a newer version.
    """
    try:
        table = pq.read_table(pa.BufferReader(path.read_bytes()))
    except (OSError, pa.ArrowInvalid) as error:
        raise ShardError(f"{path}: not readable as Parquet ({error}); run the command again") from error
    version = int((table.schema.metadata or {}).get(key, b"0"))
    if version > newest:
        raise ShardError(
            f"{path}: written by version {version}, this tool reads up to {newest}; update the tool"
        )
    return table


def with_earlier(
    out: Path, name: str, table: pa.Table, sequences: AbstractSet[str], by: Sequence[str] = ("sequence",)
) -> pa.Table:
    """Return a table with the rows that are recorded of ``sequences`` before its own, but those that it has anew.

    Args:
        by: columns; rows that are alike in them are of one measurement.

    Raises:
        ShardError: as in :func:`recorded`.
    """
    old = recorded(out, name).replace_schema_metadata(None)
    old = old.filter(pc.is_in(old.column("sequence"), pa.array(sorted(sequences), pa.string())))
    return pa.concat_tables([old.filter(pc.invert(among(old, table, by))), table.select(old.column_names)])


def among(rows: pa.Table, others: pa.Table, by: Sequence[str]) -> pa.Array:
    """Tell of each row whether one of ``others`` is alike in the text columns ``by``."""
    keys = [pc.binary_join_element_wise(*(t.column(c) for c in by), "\0") for t in (rows, others)]
    return pc.is_in(keys[0], keys[1].combine_chunks())


def _complete(table: pa.Table, wanted: pa.Schema) -> pa.Table:
    """Return the wanted columns; those that the table lacks (one of an older version, say) are null."""
    for field in wanted:
        if field.name not in table.column_names:
            table = table.append_column(field, pa.nulls(table.num_rows, field.type))
    return table.select(wanted.names)


def recorded_run(out: Path) -> dict[str, Any]:
    """Read the run's description back; empty where there is none."""
    path = out / "report" / RUN
    return dict(json.loads(path.read_text())) if path.exists() else {}
