"""One scan that breaks a kernel must not take the other scans of its GOP with it."""

from __future__ import annotations

from collections.abc import Callable

import pyarrow as pa
import pyarrow.compute as pc


def run_isolated(
    run: Callable[[list[pa.Table]], pa.Table], tables: list[pa.Table]
) -> tuple[pa.Table, dict[str, Exception]]:
    """Run a stage on the tables of a GOP; where it breaks, find the scans that break it and leave them out.

    Returns:
        the table of the others, and what each scan that was left out raised.

    Raises:
        Exception: what the kernel raised, where no single scan is to blame or none is left.
    """
    try:
        return run(tables), {}
    except Exception as whole:
        names = tables[0].column("name").to_pylist()
        guilty: dict[str, Exception] = {}
        for name in names:
            try:
                run(only(tables, {name}))
            except Exception as error:  # noqa: BLE001 (whatever it is, it is this scan's)
                guilty[name] = error
        if not guilty or len(guilty) == len(names):
            raise whole from None
        return run(only(tables, set(names) - set(guilty))), guilty


def only(tables: list[pa.Table], names: set[str]) -> list[pa.Table]:
    """Keep the rows of the named scans in each table (a scan may have one row, several or none)."""
    wanted = pa.array(sorted(names), pa.string())
    return [table.filter(pc.is_in(table.column("name"), value_set=wanted)) for table in tables]
