"""The progress bar: to stderr, so that stdout stays clean for ``--json``."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Protocol

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    SpinnerColumn,
    TextColumn,
    TimeRemainingColumn,
)

STDERR = Console(stderr=True, highlight=False)


class Report(Protocol):
    """What the graph tells whoever watches."""

    def advance(self, scans: int, doing: str) -> None:
        """``scans`` scans went through one more step; ``doing`` says where the run is."""
        ...

    def say(self, line: str) -> None:
        """Pass on one line, such as a failed scan."""
        ...


class Silent:
    """Watches nothing (Python API, tests)."""

    def advance(self, scans: int, doing: str) -> None:
        """Ignore."""

    def say(self, line: str) -> None:
        """Ignore."""


class _Bar:
    def __init__(self, progress: Progress, total: int) -> None:
        self._progress = progress
        self._task = progress.add_task("starting", total=total)

    def advance(self, scans: int, doing: str) -> None:
        self._progress.update(self._task, advance=scans, description=doing)

    def say(self, line: str) -> None:
        self._progress.console.print(line, soft_wrap=True, markup=False)


@contextmanager
def bar(total: int, dashboard: str) -> Iterator[Report]:
    """Show a bar over ``total`` steps (scans times passes) and the link of the Dask dashboard."""
    STDERR.print(f"dashboard {dashboard}", style="dim", soft_wrap=True)
    columns = (
        SpinnerColumn(),
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=STDERR) as progress:
        yield _Bar(progress, total)
