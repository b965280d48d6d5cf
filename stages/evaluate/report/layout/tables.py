"""The tables of a report: one shape for the page, for Markdown and for Parquet."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import pyarrow as pa


@dataclass(frozen=True)
class Column:
    """One column: key in the row, heading, format of its numbers, unit where it has one."""

    key: str
    heading: str
    form: str = ""

    def show(self, value: Any) -> str:
        """Write a cell; a dash where there is no figure."""
        if value is None:
            return "-"
        if isinstance(value, bool):
            return "yes" if value else "no"
        if value == 0 and self.form.endswith("e"):
            return "0"
        return format(value, self.form) if self.form and not isinstance(value, str) else str(value)


@dataclass(frozen=True)
class Table:
    """A titled table; ``note`` is a sentence under it, ``last_is_total`` sets the last row apart, ``grouped`` (the
    key of a column) a row that differs there from the one above. The first column stays in sight on a phone."""

    name: str
    title: str
    columns: tuple[Column, ...]
    rows: tuple[Mapping[str, Any], ...]
    note: str = ""
    last_is_total: bool = False
    grouped: str = ""

    def cells(self) -> list[list[str]]:
        """Every cell as text, row by row."""
        return [[column.show(row.get(column.key)) for column in self.columns] for row in self.rows]

    def is_number(self, index: int) -> bool:
        """Tell whether a column is set to the right."""
        return bool(self.columns[index].form)

    def starts_group(self, row: int) -> bool:
        """Tell whether a line is drawn above a row."""
        return (
            bool(self.grouped)
            and row > 0
            and self.rows[row].get(self.grouped) != self.rows[row - 1].get(self.grouped)
        )

    def to_markdown(self) -> str:
        """Write the table as GitHub Markdown, without its title."""
        head = "| " + " | ".join(column.heading for column in self.columns) + " |"
        rule = "|" + "|".join("---:" if column.form else "---" for column in self.columns) + "|"
        body = ["| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in self.cells()]
        return "\n".join([head, rule, *body])

    def to_arrow(self) -> pa.Table:
        """Unformatted values, one column a key; a column of mixed kinds becomes text."""
        data = {}
        for column in self.columns:
            values = [row.get(column.key) for row in self.rows]
            try:
                data[column.key] = pa.array(values)
            except (pa.ArrowInvalid, pa.ArrowTypeError):
                data[column.key] = pa.array([None if v is None else str(v) for v in values])
        return pa.table(data)


def to_document(tables: Sequence[Table]) -> str:
    """Join tables to one Markdown document."""
    parts = ["# salpcc-pipeline report", ""]
    for table in tables:
        parts += [f"## {table.title}", "", table.to_markdown(), ""]
        parts += [table.note, ""] if table.note else []
    return "\n".join(parts)
