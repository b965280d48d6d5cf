"""The progress bar: to stderr, so that stdout stays clean for ``--json``."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Protocol

from rich.console import Console
from rich.progress import (
    BarColumn,
    Progress,
    SpinnerColumn,
    TextColumn,
    TimeRemainingColumn,
)

from salpcc.stages import kernels_are_kept

STDERR = Console(stderr=True, highlight=False, emoji=False, markup=False)  # a file may be named :b: or [/b]


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
        self._progress.console.print(line, soft_wrap=True)


@contextmanager
def starting() -> Iterator[None]:
    """Turn a wheel while libraries are loaded."""
    with STDERR.status("starting"):
        yield


@contextmanager
def bar(total: int, unit: str, quiet: bool = False) -> Iterator[Report]:
    """Show a bar over ``total`` steps (scans times passes) of a ``unit``, such as "scans coded or measured"; or nothing."""
    if quiet:
        yield Silent()
        return
    columns = (
        SpinnerColumn(),
        TextColumn("{task.description}", markup=False),
        BarColumn(20),
        TextColumn(f"{{task.completed:.0f}} of {{task.total:.0f}} {unit},"),
        TimeRemainingColumn(),
        TextColumn("left"),
    )
    # The speed of all of the run: what is left goes down, and does not jump with each group.
    with Progress(
        *columns,
        console=STDERR,
        speed_estimate_period=float("inf"),
        refresh_per_second=4,
        auto_refresh=STDERR.is_terminal,
    ) as progress:
        shown = _Bar(progress, total)
        if not kernels_are_kept():
            shown.say(
                "The first run of an installation compiles its kernels, a minute or two; later ones find them."
            )
        yield shown
