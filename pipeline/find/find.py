"""Find scans in a catalogue by a condition in SQL, such as ``person > 50 and speed < 1``.

SQLite reads the condition, so any of its operators and functions can be used; an authorizer lets it read the catalogue's
columns and do nothing else.
"""

from __future__ import annotations

import json
import re
import sqlite3
from contextlib import closing
from typing import Any

import pyarrow as pa

from salpcc.pipeline.find.catalogue import CLASS_COLUMNS
from salpcc.schemas.errors import UsageError

_LONGEST = 1 << 20  # bytes of a text that a condition may make
_STEPS = 10_000  # of SQLite's machine a row, after which a condition has gone astray
_ALLOWED = {sqlite3.SQLITE_SELECT, sqlite3.SQLITE_READ, sqlite3.SQLITE_FUNCTION}


def find(catalogue: pa.Table, condition: str) -> pa.Table:
    """Return the rows of a catalogue that meet a condition, in their order.

    A comparison with what is not known of a scan (null) is not met.

    Args:
        condition: an SQL expression over the catalogue's columns.

    Raises:
        UsageError: SQLite does not read it, or it is no condition; the message lists the columns.
    """
    columns = named_columns(catalogue, condition) or catalogue.column_names[:1]
    try:
        with closing(sqlite3.connect(":memory:")) as base:
            base.execute(f"CREATE TABLE catalogue ({', '.join(columns)})")
            places = ", ".join("?" * len(columns))
            rows = zip(*(_values(catalogue, name) for name in columns), strict=True)
            base.executemany(f"INSERT INTO catalogue VALUES ({places})", rows)
            _lock(base, len(catalogue))
            # The line break ends a comment that would swallow the bracket.
            met = [
                value for (value,) in base.execute(f"SELECT ({condition}\n) FROM catalogue ORDER BY rowid")
            ]
    except (sqlite3.Error, sqlite3.Warning, ValueError, OverflowError) as error:
        raise UsageError(
            f"{condition}: {error}; columns are {', '.join(catalogue.column_names)}, and the condition is SQL, "
            'such as "person > 50 and speed < 1" or "name = \'000123\'"'
        ) from error
    if len(met) != len(catalogue) or not all(
        value is None or isinstance(value, int | float) for value in met
    ):
        raise UsageError(f'{condition}: is no condition; say what to compare, such as "points > 100000"')
    return catalogue.filter(pa.array([bool(value) for value in met], pa.bool_()))


def _values(catalogue: pa.Table, name: str) -> list[Any]:
    """A column as SQLite takes it: its whole numbers end below ``2 ** 63``, larger ones become floats; lists are JSON."""
    values = catalogue.column(name).to_pylist()
    if isinstance(catalogue.schema.field(name).type, pa.ListType):
        return [value and json.dumps(value) for value in values]
    return [float(v) if isinstance(v, int) and v >= 1 << 63 else v for v in values]


def named_columns(catalogue: pa.Table, condition: str) -> list[str]:
    """Columns that a condition may name; SQL takes names in any case."""
    words = {word.lower() for word in re.findall(r"\w+", condition)}
    return [name for name in catalogue.column_names if name.lower() in words]


def not_known(catalogue: pa.Table, condition: str) -> list[str]:
    """Say of which columns of a condition nothing is known of some scans, and how to come to know it."""
    lines = []
    for name in named_columns(catalogue, condition):
        if unknown := catalogue.column(name).null_count:
            how = "; runs count classes that labels give (--labels given) or the network finds (no --keep-movable)"
            counted = name in CLASS_COLUMNS or name in ("ground", "other", "static", "movable")
            of = "any" if unknown == len(catalogue) else f"{unknown:,} of {len(catalogue):,}"
            lines.append(
                f"{name}: not known of {of} scan{'' if of == 'any' else 's'}{how if counted else ''}"
            )
    return lines


def _lock(base: sqlite3.Connection, rows: int) -> None:
    """From here on the base can be read, and nothing else of this machine."""
    base.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, _LONGEST)
    base.set_progress_handler(lambda: 1, _STEPS * (rows + 1))
    base.set_authorizer(lambda action, *_: sqlite3.SQLITE_OK if action in _ALLOWED else sqlite3.SQLITE_DENY)
